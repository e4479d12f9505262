"""Starting, losing and closing engines."""

import faulthandler
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
import vizdoom

from tests.envs.children import Child, run
from tests.envs.layouts import LANE
from toponav.envs import EngineError, EngineLostError
from toponav.envs.engines.doom import (
    engine as engine_module,
    hang_watch,
    instances,
    shared_memory,
)
from toponav.envs.engines.doom.engine import Engine, fixed, turn
from toponav.envs.engines.doom.level import acs
from toponav.envs.engines.doom.level.compile import compile_maze
from toponav.envs.engines.doom.level.wad import wad_file

MAZE = compile_maze(LANE)
# A terminal sends Ctrl-C to the whole process group, and so do some schedulers SIGTERM.
_SIGNALS = {
    "Ctrl-C": signal.SIGINT,
    "SIGTERM": signal.SIGTERM,
    "Ctrl-C to the group": signal.SIGINT,
    "SIGTERM to the group": signal.SIGTERM,
}


def start() -> Engine:
    return Engine(wad_file(MAZE.wad), MAZE.map_name)


def look_often(monkeypatch: pytest.MonkeyPatch) -> None:
    """End engines that do nothing for two seconds, by a watch of its own."""
    monkeypatch.setattr(hang_watch, "_LOOK_S", 0.2)
    monkeypatch.setattr(hang_watch, "_LOOKS", 10)
    monkeypatch.setattr(hang_watch, "_thread", None)


def test_numbers_are_the_scripts_fixed_point() -> None:
    # 1.5 x 65536; 20 / 360 x 65536 = 3640.9; 360 degrees are none.
    assert (fixed(1.5), fixed(-0.25)) == (98304, -16384)
    assert (turn(90.0), turn(20.0), turn(360.0), turn(359.9999)) == (16384, 3641, 0, 0)


def test_a_closed_engine_says_so() -> None:
    engine = start()
    engine.close()
    engine.close()
    with pytest.raises(EngineError, match="must be running, and it was closed"):
        engine.act([0, 0, 0])


class TestMissing:
    @pytest.mark.slow
    def test_the_remedy_is_in_the_error(self) -> None:
        # As on a machine that has no wheel; all but the engine still works.
        hide = "import sys\nsys.modules['vizdoom'] = None\n"
        script = """
from toponav.envs import EngineError, load_maze
print(load_maze("maze1").num_cells)
try:
    MazeEnv(LANE)
except EngineError as error:
    print(error)
"""
        lines = run(script, before=hide).splitlines()
        assert lines[0] == "51"
        assert lines[1].startswith(
            "the ViZDoom engine must be installed, and it is not"
        )
        assert "pip has wheels of 'vizdoom' for Linux" in lines[1]
        assert "build it from source (https://vizdoom.farama.org)" in lines[1]


class TestWorkingFolder:
    @pytest.mark.slow
    @pytest.mark.parametrize("mode", [0o755, 0o555], ids=["writable", "read-only"])
    def test_nothing_is_written_into_it(self, tmp_path: Path, mode: int) -> None:
        tmp_path.chmod(mode)
        before = tmp_path.stat().st_mtime_ns
        run(
            "env = MazeEnv(LANE, batch_size=4, texture_seed=77)\n"
            "env.rollout(5)\nenv.close()",
            cwd=tmp_path,
        )
        tmp_path.chmod(0o755)
        assert list(tmp_path.iterdir()) == []
        # Nor written and removed again: the folder's own time would tell.
        assert tmp_path.stat().st_mtime_ns == before


class TestManyStarts:
    @pytest.mark.skipif(sys.platform != "linux", reason="asks the C library for a hook")
    def test_processes_are_forked_one_after_the_other(self) -> None:
        # The hook stands for OpenBLAS's, which ends its threads before each fork, and
        # where two such hooks at once wait for the same thread, one may never return.
        script = """
import ctypes

inside, most, count = 0, 0, 0
lock = threading.Lock()

@ctypes.CFUNCTYPE(None)
def before_fork():
    global inside, most, count
    with lock:
        inside, count = inside + 1, count + 1
        most = max(most, inside)
    time.sleep(0.2)
    with lock:
        inside -= 1

getattr(ctypes.CDLL(None), "__register_atfork")(before_fork, None, None, None)
MazeEnv(LANE, batch_size=4).close()
print(most, count >= 4)
"""
        assert run(script).split() == ["1", "True"]

    @pytest.mark.slow
    def test_forty_eight_at_once_all_succeed(self) -> None:
        script = (
            "env = MazeEnv(LANE, batch_size=8)\nenv.rollout(2)\n"
            "report(env)\nenv.close()"
        )
        with ThreadPoolExecutor(6) as pool:
            children = list(pool.map(lambda _: Child(script), range(6)))
        try:
            engines = [pid for child in children for pid in child.engines()]
            assert len(set(engines)) == 48
            identifiers = [name for child in children for name in child.ids]
            assert len(set(identifiers)) == 48
        finally:
            for child in children:
                child.go_on()
            ended = [child.wait() for child in children]
        assert [status for status, _, _ in ended] == [0] * 6, ended


class TestLosses:
    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
    def test_a_signal_to_the_process_group_ends_no_engine(self, number: int) -> None:
        engine = start()
        try:
            engine.new_episode()
            os.kill(engine.pid, number)
            for _ in range(3):
                engine.act([0, 0, 0])
        finally:
            engine.close()

    @pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
    def test_one_that_is_killed_or_hangs_is_lost_and_starts_again(
        self, monkeypatch: pytest.MonkeyPatch, number: int
    ) -> None:
        look_often(monkeypatch)
        engine = start()
        try:
            engine.new_episode()
            pid = engine.pid
            os.kill(pid, number)
            with pytest.raises(EngineLostError, match="the engine died"):
                engine.act([0, 0, 0])
            # Whatever is asked of it, it says the same.
            for ask in (
                lambda: engine.run_script(acs.OPEN_SLOT, 1),
                engine.new_episode,
                engine.observe,
                lambda: engine.pid,
            ):
                with pytest.raises(EngineLostError):
                    ask()
            engine.restart()
            engine.new_episode()
            engine.act([0, 0, 0])
            assert engine.pid != pid
            assert engine.observe()[0].shape == (120, 160, 3)
        finally:
            engine.close()

    def test_one_that_hangs_unasked_is_left_alone_until_it_is_closed(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        look_often(monkeypatch)
        engine = start()
        try:
            os.kill(pid := engine.pid, signal.SIGSTOP)
            time.sleep(2.5)
            os.kill(pid, signal.SIGCONT)
            engine.new_episode()
            os.kill(pid, signal.SIGSTOP)
        finally:
            engine.close()
        assert not psutil.pid_exists(pid)

    def test_an_engine_that_works_for_long_is_waited_for(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        look_often(monkeypatch)
        engine = start()
        try:
            engine.new_episode()
            began = time.monotonic()
            engine.act([0, 0, 0], tics=2_000)
            took = time.monotonic() - began
            # One call of five seconds.
            engine.act([0, 0, 0], tics=round(2_000 * 5 / took))
            assert time.monotonic() - began > 3
        finally:
            engine.close()

    def test_an_engine_that_dies_while_it_starts_is_given_up(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        # The engine's own start then never returns.
        monkeypatch.setattr(engine_module, "_SECONDS_WITHOUT_PROCESS", 0.5)
        forever = threading.Event()
        monkeypatch.setattr(vizdoom.DoomGame, "init", lambda _: forever.wait())
        # It is not there before the first engine.
        instances.registry().mkdir(mode=0o700, parents=True, exist_ok=True)
        before = set(instances.registry().iterdir())
        begin = time.monotonic()
        try:
            with pytest.raises(EngineError, match="it has no process: it was ended"):
                start()
        finally:
            forever.set()
        assert time.monotonic() - begin < 20
        assert set(instances.registry().iterdir()) == before

    @pytest.mark.parametrize("works", [True, False])
    def test_a_slow_start_is_waited_for_while_it_works(
        self, monkeypatch: pytest.MonkeyPatch, works: bool
    ) -> None:
        # As beside others that take nearly all of the processor.
        begin, seconds = vizdoom.DoomGame.init, itertools.count(step=int(works))

        def begin_slowly(game: vizdoom.DoomGame) -> None:
            begin(game)
            time.sleep(3.5)

        monkeypatch.setattr(vizdoom.DoomGame, "init", begin_slowly)
        monkeypatch.setattr(instances, "seconds_worked", lambda _: next(seconds))
        monkeypatch.setattr(engine_module, "_IDLE_SECONDS", 1.5)
        if works:
            start().close()
            return
        with pytest.raises(EngineError, match=r"did nothing for 1\.5 s"):
            start()

    @pytest.mark.parametrize("end", ["it is stopped", *_SIGNALS])
    def test_one_that_does_not_start_takes_nobody_along(
        self, tmp_path: Path, end: str
    ) -> None:
        # ViZDoom reads what is not there if it dies before it has started.
        file = tmp_path / "said"
        with file.open("w") as output:  # the engine would hold a pipe open
            process = subprocess.Popen(
                [sys.executable, "-c", f"{_WHILE_IT_STARTS}\nstart_and({end!r})"],
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        status = -_SIGNALS.get(end, 0)
        ended = process.wait(60)
        pid, *said = file.read_text().splitlines()
        assert ended == status, said
        assert said == ["given up"] or status != 0
        # What it left is for the next start.
        instances.sweep()
        assert not psutil.pid_exists(int(pid))

    def test_one_that_is_killed_while_it_starts_leaves_no_shared_memory(
        self, tmp_path: Path
    ) -> None:
        # ViZDoom may take its process along.
        file = tmp_path / "identifier"
        context = multiprocessing.get_context("fork")
        child = context.Process(target=kill_while_it_starts, args=(file,))
        child.start()
        child.join(60)
        assert not child.is_alive()
        instances.sweep()
        left = shared_memory.SHARED_MEMORY.glob(f"ViZDoom*{file.read_text()}")
        assert not list(left)


_WHILE_IT_STARTS = "from tests.envs.engines.doom.test_engine import start_and"


def start_and(end: str) -> None:
    """Start an engine, and end it or this process before it has started."""
    engine_module._IDLE_SECONDS, instances._PATIENCE_S = 1.0, 0.5
    signal.signal(signal.SIGINT, signal.default_int_handler)
    engine_pid, seen = instances.engine_pid, set[int]()

    def act_once(folder: Path) -> int | None:
        if (pid := engine_pid(folder)) is not None and not seen:
            seen.add(pid)
            sys.stdout.write(f"{pid}\n")
            sys.stdout.flush()
            if end == "it is stopped":
                os.kill(pid, signal.SIGSTOP)
            elif end.endswith("to the group"):
                os.killpg(0, _SIGNALS[end])
            else:
                os.kill(os.getpid(), _SIGNALS[end])
        return pid

    instances.engine_pid = act_once
    with suppress(EngineError):
        start()
    sys.stdout.write("given up\n")


def kill_while_it_starts(file: Path) -> None:
    """Start an engine that is killed as soon as there is one; note its identifier."""
    faulthandler.disable()
    engine_pid = instances.engine_pid

    def kill_at_once(folder: Path) -> int | None:
        if (pid := engine_pid(folder)) is not None:
            words = psutil.Process(pid).cmdline()
            file.write_text(words[words.index("+viz_instance_id") + 1])
            os.kill(pid, signal.SIGKILL)
        return pid

    instances.engine_pid = kill_at_once
    start()
