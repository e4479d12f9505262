"""Starting, losing and closing engines; what is refused, on the stand-in alone."""

import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.envs.layouts import GATE, LANE
from tests.envs.test_engines import STAND_IN
from toponav.builders import engine_world
from toponav.envs import (
    EngineError,
    EngineLostError,
    Layout,
    MazeEnv,
    make_random_layout,
)
from toponav.envs.cache import cache_folder
from toponav.envs.engines.dmlab import text_level
from toponav.envs.engines.dmlab.child import MapCache
from toponav.envs.engines.dmlab.engine import Engine
from toponav.envs.engines.dmlab.game import MazeGame
from toponav.envs.engines.dmlab.text_level import level_settings, scene_text
from toponav.envs.game import Look
from toponav.envs.scene import Pose, Scene

REPOSITORY = Path(__file__).parents[4]
SETTINGS = level_settings(LANE, Look())
SCENE = Scene(
    start=Pose(150.0, 150.0, 0.0),
    apples=(),
    goal=None,
    goal_cell=None,
    blocked=(),
    next_start=lambda: Pose(150.0, 150.0, 0.0),
)


@pytest.fixture
def engine(module: str) -> Iterator[Engine]:
    engine = Engine(SETTINGS)
    yield engine
    engine.close()


@pytest.mark.parametrize(
    "start", [lambda: engine_world("dmlab"), lambda: MazeEnv(LANE, engine="dmlab")]
)
def test_without_the_engine_one_sentence_says_what_to_do(
    start: Callable[[], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(EngineError) as caught:
        start()
    said = str(caught.value)
    assert said.startswith("the DeepMind Lab engine must be installed, and there is no")
    assert "https://github.com/google-deepmind/lab" in said
    assert said.endswith("or use engine=vizdoom")
    assert "\n" not in said


class TestLoss:
    def test_a_killed_engine_is_lost_and_replaced(self, engine: Engine) -> None:
        scene = scene_text(LANE, SETTINGS, SCENE)
        engine.reset(scene, idle=1)
        first = engine.pid
        os.kill(first, signal.SIGKILL)
        with pytest.raises(EngineLostError, match=r"engine died: exit status -9"):
            engine.act([0] * 7, frames=1)
        engine.restart()
        assert engine.pid != first
        pose = engine.reset(scene, idle=1)[1]
        assert pose == pytest.approx([150.0, 150.0, 0.0], abs=0.01)

    def test_one_that_dies_while_it_starts_is_one_sentence(
        self, stand_in: None, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("STAND_IN", "dies on import")
        rule = r"engine must start, got: the engine died: exit status 1; its last"
        with pytest.raises(EngineError, match=f"{rule} output: the stand-in was told"):
            Engine(SETTINGS)

    def test_one_that_no_process_can_be_started_for_leaves_nothing(
        self, stand_in: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        def refuse(*given: object, **named: object) -> None:
            raise OSError("no more processes")

        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        monkeypatch.setattr(subprocess, "Popen", refuse)
        rule = "the engine must start, got: no more processes"
        with pytest.raises(EngineError, match=rule):
            Engine(SETTINGS)
        assert not list(tmp_path.glob("toponav-dmlab-*"))

    def test_what_the_engine_refuses_is_said(self, stand_in: None) -> None:
        rule = r"the engine must start, got: RuntimeError: the stand-in has not seen"
        with pytest.raises(EngineError, match=rule):
            Engine({**SETTINGS, "wings": "2"})

    def test_a_closed_engine_says_so(self, engine: Engine) -> None:
        engine.close()
        engine.close()
        with pytest.raises(EngineError, match="must be running, and it was closed"):
            engine.act([0] * 7, frames=1)


class TestEnd:
    def test_nothing_is_left(self, module: str, alive: Callable[[int], bool]) -> None:
        engine = Engine(SETTINGS)
        folder, pid = engine._folder, engine.pid
        assert folder.exists()
        engine.close()
        assert not alive(pid)
        assert not folder.exists()

    def test_nothing_is_left_of_a_large_maze(
        self, stand_in: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        layout = make_random_layout(40, 40, seed=0)
        # Linux takes no longer argument of a process.
        assert len(str(level_settings(layout, Look()))) > 131_072
        game = MazeGame(layout)
        assert len(list(tmp_path.glob("toponav-dmlab-*"))) == 1
        game.close()
        assert not list(tmp_path.glob("toponav-dmlab-*"))

    def test_it_ends_with_its_owner(
        self, module: str, alive: Callable[[int], bool]
    ) -> None:
        script = (
            "import os, signal\nfrom tests.envs.layouts import LANE\n"
            "from toponav.envs.engines.dmlab.engine import Engine\n"
            "from toponav.envs.engines.dmlab.text_level import level_settings\n"
            "from toponav.envs.game import Look\n"
            "engine = Engine(level_settings(LANE, Look()))\n"
            "print(engine.pid, engine._folder, flush=True)\n"
            # A fork holds the socket open.
            "if os.fork() == 0:\n    signal.pause()\n"
            "os.kill(os.getpid(), signal.SIGKILL)\n"
        )
        places = [REPOSITORY, *([STAND_IN] if module == "stand-in" else [])]
        path = os.pathsep.join(map(str, places))
        owner = subprocess.Popen(
            [sys.executable, "-c", script],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": path},
            start_new_session=True,
        )
        try:
            assert owner.stdout is not None
            pid, folder = owner.stdout.readline().split()
            assert owner.wait(120) == -signal.SIGKILL
            deadline = time.monotonic() + 120
            while alive(int(pid)) or Path(folder).exists():
                assert time.monotonic() < deadline
                time.sleep(0.1)
        finally:
            os.killpg(owner.pid, signal.SIGKILL)


class TestMaps:
    def test_a_map_is_compiled_once(
        self, module: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        kept = []
        for _ in range(2):
            game = MazeGame(LANE)
            try:
                game.reset(SCENE)
            finally:
                game.close()
            name = scene_text(LANE, SETTINGS, SCENE).split()[1]
            kept.append(
                [
                    (path, path.stat().st_mtime_ns)
                    for path in cache_folder("dmlab-maps").glob(f"{name}*.pk3")
                ]
            )
        assert len(kept[0]) == 1
        assert kept[0] == kept[1]

    @pytest.mark.timeout(150)
    def test_one_that_does_not_compile_keeps_nobody_waiting(
        self, stand_in: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        monkeypatch.setenv("STAND_IN", "compiles nothing")
        monkeypatch.setattr("toponav.envs.engines.dmlab.engine._SECONDS", 30.0)
        engines = [Engine(SETTINGS), Engine(SETTINGS)]
        try:
            for engine in engines:
                with pytest.raises(EngineError, match="stand-in was told to compile"):
                    engine.reset(scene_text(LANE, SETTINGS, SCENE), idle=1)
        finally:
            for engine in engines:
                engine.close()

    @pytest.mark.timeout(60)
    def test_one_that_cannot_be_read_keeps_nobody_waiting(self, tmp_path: Path) -> None:
        (tmp_path / "map.pk3").mkdir()
        for cache in [MapCache(tmp_path), MapCache(tmp_path)]:
            with pytest.raises(IsADirectoryError):
                cache.fetch("map", str(tmp_path / "copy"))

    def test_its_name_is_its_content(self) -> None:
        def name(layout=GATE, look: Look = Look(), blocked=()) -> str:  # noqa: B008
            scene = Scene(SCENE.start, (), None, None, blocked, SCENE.next_start)
            return scene_text(layout, level_settings(layout, look), scene).split()[1]

        others = {
            name(LANE),
            name(look=Look(texture_seed=1)),
            name(look=Look(paintings=0.0)),
            name(blocked=("a",)),
        }
        assert len(others) == 4
        assert name() not in others
        assert name() == name()


class TestLook:
    def test_it_is_computed_once(
        self, stand_in: None, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        assign, calls = text_level.assign_regions, []

        def count(layout: Layout, generator: np.random.Generator) -> object:
            calls.append(layout)
            return assign(layout, generator)

        monkeypatch.setattr(text_level, "assign_regions", count)
        game = MazeGame(LANE)
        try:
            for _ in range(3):
                game.reset(SCENE)
        finally:
            game.close()
        assert calls == [LANE]

    def test_a_closed_slot_changes_nothing_else(self) -> None:
        # The settings know nothing of scenes; their pictures hang on walls alone.
        settings = level_settings(GATE, Look(paintings=1.0))
        sides = [line.split()[:3] for line in settings["pictures"].splitlines()]
        # 6 x 5 cells: 14 sides of the outer wall and 6 of the block in the middle.
        assert len(sides) == 14 + 6
        for row, column, side in sides:
            down, right = {"N": (-1, 0), "E": (0, 1), "S": (1, 0), "W": (0, -1)}[side]
            cell = int(row) - 1, int(column) - 1
            assert GATE.open_mask[cell]
            assert not GATE.open_mask[cell[0] + down, cell[1] + right]

    def test_regions_have_their_walls_and_floors(self) -> None:
        settings = level_settings(GATE, Look())
        assert settings["regions"] == "\n".join(
            "".join("A" if letter != "*" else "." for letter in row)
            for row in GATE.rows
        )
        letter, wall, floor = settings["styles"].split()
        assert letter == "A"
        assert wall.startswith("map/lab_games/lg_style_")
        assert "wall" in wall
        assert "floor" in floor

    def test_another_seed_is_another_look(self) -> None:
        assert level_settings(GATE, Look()) != level_settings(
            GATE, Look(texture_seed=1)
        )

    def test_without_paintings_no_picture(self) -> None:
        assert level_settings(GATE, Look(paintings=0.0))["pictures"] == ""
