"""Folders that cannot be written, full disks, no shared memory: one sentence each."""

import errno
import os
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.forked import run_forked
from toponav.config import SettingsError
from toponav.runs import require_room, require_shared_memory, room

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="no such folder elsewhere")


def read_only(**_: object) -> None:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def with_free(megabytes: float, monkeypatch: pytest.MonkeyPatch) -> None:
    free = SimpleNamespace(free=megabytes * 1e6)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: free)


def refusal(call, *given: object) -> str:
    with pytest.raises(SettingsError) as caught:
        call(*given)
    return str(caught.value)


def test_a_folder_is_looked_at_where_it_would_be_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new = tmp_path / "new" / "deep"
    with_free(7, monkeypatch)
    require_room(new, "hydra.run.dir", 7)
    assert refusal(require_room, new, "hydra.run.dir", 8) == (
        "hydra.run.dir must name a folder on a disk with room for 8 MB, got "
        f"'{new}' with 7.0 MB free"
    )
    monkeypatch.setattr(room.tempfile, "TemporaryFile", read_only)
    assert refusal(require_room, new, "hydra.run.dir", 1) == (
        "hydra.run.dir must name a folder that can be written to, got "
        f"'{new}' (Read-only file system)"
    )
    assert not list(tmp_path.iterdir())


@LINUX
def test_shared_memory_must_be_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "SHARED_MEMORY", tmp_path)
    rule = f"{tmp_path} must have room for 6.0 MB, which processes of this run share "
    rule += "(less with a smaller collect.envs), got "
    with_free(6, monkeypatch)
    require_shared_memory(6, "collect.envs")
    with_free(5, monkeypatch)
    said = refusal(require_shared_memory, 6, "collect.envs")
    assert said == f"{rule}5.0 MB; in Docker, --shm-size sets it"
    monkeypatch.setattr(room.tempfile, "TemporaryFile", read_only)
    said = refusal(require_shared_memory, 6, "collect.envs")
    assert said == f"{rule}none (Read-only file system)"


@LINUX
def test_a_recipe_without_shared_memory_starts_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "SHARED_MEMORY", tmp_path / "none")
    words = ("scale=smoke", "hydra.run.dir=run")
    done = run_forked("pretrain", *words, cwd=tmp_path)
    (sentence,) = done.stderr.splitlines()
    assert done.returncode == 2
    assert sentence.startswith(f"pretrain: {tmp_path}/none must have room for 0.4 MB")
    assert sentence.endswith("got none (No such file or directory)")
    assert not list(tmp_path.iterdir())
