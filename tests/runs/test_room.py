"""Whether there is room: said in one sentence, before anything is written."""

import shutil
from collections import namedtuple
from pathlib import Path
from unittest.mock import Mock

import psutil
import pytest

from toponav.config import SettingsError
from toponav.runs import require_memory, require_room, require_shared_memory, room

Usage = namedtuple("Usage", "total used free")


def said(check, *arguments: object) -> str:
    with pytest.raises(SettingsError) as error:
        check(*arguments)
    return str(error.value)


def test_where_there_is_room_nothing_is_said_or_left(tmp_path: Path) -> None:
    require_room(tmp_path / "new" / "run", "hydra.run.dir", 1)
    require_shared_memory(0.001, "collect.envs")
    assert not list(tmp_path.iterdir())


def test_a_folder_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert said(require_room, tmp_path / "file" / "run", "resume", 1) == (
        "resume must name a folder that can be written to, got "
        f"'{tmp_path}/file/run' (Not a directory)"
    )


@pytest.mark.parametrize(("free", "given"), [(2_500_000, "2.5"), (0, "0.0")])
def test_a_full_disk_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: int, given: str
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9, free))
    folder = tmp_path / "new"
    assert said(require_room, folder, "pretraining.folder", 12) == (
        "pretraining.folder must name a folder on a disk with room for 12 MB, got "
        f"'{folder}' with {given} MB free"
    )
    assert said(require_shared_memory, 70, "collect.envs") == (
        "/dev/shm must have room for 70 MB, which processes of this run share (less "
        f"with a smaller collect.envs), got {given} MB; in Docker, --shm-size sets it"
    )


def test_more_memory_than_the_machine_has_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(psutil, "virtual_memory", lambda: Mock(total=8_000_000))
    require_memory(8, "locomotion.memory")
    assert said(require_memory, 9, "locomotion.memory") == (
        "locomotion.memory must be smaller, or the machine have 9 MB of memory, got 8 "
        "MB"
    )


def test_a_machine_without_shared_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "SHARED_MEMORY", tmp_path / "shm")
    assert said(require_shared_memory, 7, "collect.batch") == (
        f"{tmp_path}/shm must have room for 7 MB, which processes of this run share "
        "(less with a smaller collect.batch), got none (No such file or directory)"
    )
