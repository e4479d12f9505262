"""Bad WADs end a child process, and never Python."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.envs.doom_files import lumps_of
from tests.envs.layouts import LANE
from tests.envs.scenes import scene_at
from toponav.envs import EngineError
from toponav.envs.engines.doom import game as game_module
from toponav.envs.engines.doom.engine import Engine
from toponav.envs.engines.doom.game import MazeGame
from toponav.envs.engines.doom.level import wad as wad_module
from toponav.envs.engines.doom.level.compile import CompiledMaze, compile_maze
from toponav.envs.engines.doom.level.wad import build_wad, check_wad

MAZE = compile_maze(LANE)
LUMPS = lumps_of(MAZE.wad)


def without(name: str) -> bytes:
    return build_wad([lump for lump in LUMPS if lump[0] != name])


def changed(name: str, change: Callable[[bytes], bytes]) -> bytes:
    return build_wad(
        [(lump, change(data) if lump == name else data) for lump, data in LUMPS]
    )


def without_start(textmap: bytes) -> bytes:
    start = textmap.index(b"thing{")
    return textmap[:start]


def leaky(textmap: bytes) -> bytes:
    return textmap.replace(b"sidefront=7;", b"sidefront=99;")


BAD = {
    "no ENDMAP": without("ENDMAP"),
    "no player start": changed("TEXTMAP", without_start),
    "leaky sector": changed("TEXTMAP", leaky),
    "geometry that is no text": changed("TEXTMAP", lambda _: b"\0\1\2 linedef{{{"),
    "bad actor definitions": changed("DECORATE", lambda _: b"ACTOR Broken : {{{ ???"),
    "truncated file": MAZE.wad[: len(MAZE.wad) // 2],
    "not a WAD": b"\x7fELF" + bytes(1000),
    "empty file": b"",
}


@pytest.fixture
def wad(tmp_path: Path) -> Path:
    return tmp_path / "maze.wad"


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_an_engine_error(wad: Path, name: str) -> None:
    wad.write_bytes(BAD[name])
    with pytest.raises(EngineError, match=r"engine must load maze\.wad"):
        check_wad(wad, MAZE.map_name, seconds=30)
    # The mark of a good file must not be there at the second try.
    with pytest.raises(EngineError):
        check_wad(wad, MAZE.map_name, seconds=30)


def test_an_unknown_map_is_refused_at_once(wad: Path) -> None:
    # The engine looks for it endlessly, or shows another file's map.
    wad.write_bytes(MAZE.wad)
    with pytest.raises(EngineError, match="it holds no map named 'MZNONE'"):
        check_wad(wad, "MZNONE")


def test_an_engine_that_hangs_is_given_up(
    wad: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wad_module, "_LOAD_ONCE", "import time\ntime.sleep(60)")
    wad.write_bytes(changed("ZMAPINFO", lambda text: text + b"\n// never loaded\n"))
    begin = time.monotonic()
    with pytest.raises(EngineError, match=r"within 0\.5 s, and it hangs"):
        check_wad(wad, MAZE.map_name, seconds=0.5)
    assert time.monotonic() - begin < 15


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"gone\.wad"):
        check_wad(tmp_path / "gone.wad", "MZNONE")


@pytest.mark.slow
def test_an_engine_never_loads_a_bad_file_itself(wad: Path, registered) -> None:
    wad.write_bytes(BAD["no ENDMAP"])
    before = registered()
    with pytest.raises(EngineError, match="engine must load"):
        Engine(wad, MAZE.map_name)
    assert registered() == before


@pytest.mark.slow
def test_scripts_that_do_not_run_are_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The engine loads garbage in the place of scripts, and the agent stays put.
    broken = CompiledMaze(changed("BEHAVIOR", lambda _: b"garbage"), MAZE.map_name)
    monkeypatch.setattr(game_module, "compile_maze", lambda *_, **__: broken)
    game = MazeGame(LANE)
    try:
        with pytest.raises(EngineError, match="agent must start at"):
            game.reset(scene_at(LANE, (448, 192, 90)))
    finally:
        game.close()


def test_a_good_file_is_tried_once(wad: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wad.write_bytes(changed("ZMAPINFO", lambda text: text + b"\n// another file\n"))
    check_wad(wad, MAZE.map_name)
    # A second child would not even start.
    monkeypatch.setattr("sys.executable", "/nonexistent")
    check_wad(wad, MAZE.map_name)
    with pytest.raises(EngineError, match="no map named 'MZOTHER'"):
        check_wad(wad, "MZOTHER")
