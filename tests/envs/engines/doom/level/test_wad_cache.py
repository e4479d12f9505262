"""WAD files on disk."""

import hashlib
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import platformdirs
import pytest

from tests.envs.layouts import HALL, LANE
from toponav.envs.engines.doom.level.compile import compile_maze
from toponav.envs.engines.doom.level.wad import wad_file


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda _: str(tmp_path))
    return tmp_path / "wads"


def test_the_content_names_the_file(cache: Path) -> None:
    maze = compile_maze(LANE)
    path = wad_file(maze.wad)
    assert path == cache / f"{hashlib.sha256(maze.wad).hexdigest()}.wad"
    assert path.read_bytes() == maze.wad
    assert wad_file(compile_maze(HALL).wad) != path


def test_a_file_is_written_once(cache: Path) -> None:
    maze = compile_maze(LANE)
    before = wad_file(maze.wad).stat()
    assert wad_file(maze.wad).stat().st_ino == before.st_ino


@pytest.mark.parametrize("damage", [b"", b"PWAD", b"x" * 10**6])
def test_a_damaged_file_is_written_again(cache: Path, damage: bytes) -> None:
    maze = compile_maze(LANE)
    path = wad_file(maze.wad)
    path.write_bytes(damage)
    assert wad_file(maze.wad).read_bytes() == maze.wad


def test_many_writers_leave_one_whole_file(cache: Path) -> None:
    maze = compile_maze(LANE)
    with ThreadPoolExecutor(16) as pool:
        paths = set(pool.map(lambda _: wad_file(maze.wad), range(64)))
    assert [path.read_bytes() for path in paths] == [maze.wad]
    assert list(cache.iterdir()) == list(paths)


def test_what_a_killed_writer_left_goes_after_an_hour(cache: Path) -> None:
    wad_file(compile_maze(LANE).wad)
    old, new = cache / ".a.half", cache / ".b.half"
    for half, age in ((old, 4000), (new, 60)):
        half.touch()
        os.utime(half, (time.time() - age,) * 2)
    wad_file(compile_maze(HALL).wad)
    assert not old.exists()
    assert new.exists()
