"""No engine outlives its owner, and no living owner loses one."""

import math
import mmap
import os
import shutil
import signal
import time
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from tests.envs.children import Child, run
from tests.envs.layouts import LANE
from toponav.envs import EngineError, MazeEnv
from toponav.envs.engines.doom import instances, shared_memory

ENV = "env = MazeEnv(LANE, batch_size=2)\nenv.reset()\n"


def ends(condition: Callable[[], object], seconds: float = 10.0) -> bool:
    """Whether a condition stops holding in time."""
    end = time.monotonic() + seconds
    while condition() and time.monotonic() < end:
        time.sleep(0.05)
    return not condition()


def claimed_by(pid: int, started: str) -> Path:
    """A folder as another process would have claimed it."""
    folder = instances.registry() / f"{pid}-{started}-x"
    folder.mkdir(parents=True)
    return folder


class TestEndings:
    """However Python ends, short of SIGKILL: no process and no file is left."""

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("ending", "status"),
        [
            ("env.close()", 0),
            ("", 0),
            ("sys.exit(3)", 3),
            ("raise RuntimeError('mine')", 1),
            ("env.rollout(10**6)", -signal.SIGTERM),
            ("time.sleep(60)", -signal.SIGTERM),
            ("env.rollout(10**6)", -signal.SIGINT),
            ("time.sleep(60)", -signal.SIGINT),
        ],
        ids=[
            *("close", "plain exit", "sys.exit", "exception"),
            *("SIGTERM in a step", "SIGTERM asleep"),
            *("Ctrl-C in a step", "Ctrl-C asleep"),
        ],
    )
    def test_leave_nothing(self, ending: str, status: int) -> None:
        child = Child(ENV + "report(env)\n" + ending)
        assert len(child.engines()) == 2
        assert len(child.shared_memory()) == 6
        child.go_on()
        if status < 0:
            time.sleep(0.5)
            child.process.send_signal(-status)
        code, _, errors = child.wait()
        assert code == status, errors
        assert ends(child.engines), "the engines must end"
        assert child.shared_memory() == []
        assert not list(instances.registry().iterdir())

    def test_of_sigterm_is_left_to_whoever_handles_it(self) -> None:
        child = Child(
            "signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))\n"
            + ENV
            # Not one long sleep: a signal just before it would not cut it short.
            + "report(env)\nwhile True: time.sleep(0.05)"
        )
        child.go_on()
        child.process.terminate()
        code, _, errors = child.wait()
        assert code == 143, errors
        assert ends(child.engines)
        assert child.shared_memory() == []


class TestSweep:
    @pytest.mark.slow
    def test_removes_what_a_sigkill_left_at_the_next_start(self) -> None:
        child = Child(ENV + "report(env)")
        child.process.kill()
        child.process.wait(10)
        # The engines know nothing of it and wait endlessly, with its pipes open.
        assert len(child.engines()) == 2
        assert len(child.shared_memory()) == 6
        run("MazeEnv(LANE).close()")
        assert child.engines() == []
        assert child.shared_memory() == []
        assert not list(instances.registry().iterdir())

    @pytest.mark.slow
    def test_ends_an_engine_whose_owner_removed_its_folder_too_early(self) -> None:
        # The owner was told to end while the engine started: it did not see it yet.
        child = Child(ENV + "report(env)")
        child.process.kill()
        child.process.wait(10)
        for folder in instances.registry().iterdir():
            shutil.rmtree(folder)
        assert len(child.engines()) == 2
        assert instances.sweep() == 2
        assert child.engines() == []
        assert child.shared_memory() == []

    @pytest.mark.slow
    def test_never_touches_engines_of_a_living_owner(self) -> None:
        env = MazeEnv(LANE)
        try:
            env.reset()
            pid = env.games.pids
            out = run("for _ in range(3): MazeEnv(LANE).close()\nprint('swept')")
            assert out == "swept\n"
            assert env.games.pids == pid
            env.rollout(3)
        finally:
            env.close()

    def test_does_not_trust_the_wall_clock(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        # A drifting clock moves psutil's start time by a second.
        folder = instances.claim()
        try:
            moved = psutil.Process().create_time() + 1.3
            monkeypatch.setattr(psutil.Process, "create_time", lambda _: moved)
            assert instances.sweep() == 0
            assert folder.is_dir()
        finally:
            instances.release(folder)
        assert not folder.exists()

    def test_takes_a_later_process_of_the_same_number_for_dead(self) -> None:
        folder = claimed_by(os.getpid(), "1")
        assert instances.sweep() == 1
        assert not folder.exists()

    def test_takes_a_zombie_for_dead(self) -> None:
        # Its parent has not asked for its exit status yet.
        pid = os.fork()
        if pid == 0:
            os._exit(0)
        try:
            assert ends(lambda: psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
            stat = Path(f"/proc/{pid}/stat").read_text()
            claimed_by(pid, stat.rpartition(")")[2].split()[19])
            assert instances.sweep() == 1
        finally:
            os.waitpid(pid, 0)

    @pytest.mark.parametrize(
        "name",
        [
            *("garbage", "-", "--", "1-2", "--1-1-x", "-1-1-x", ".-1-x", "one-1-x"),
            *("99999999-1-x", f"{10**60}-1-x", "1-1-1-x", "\udcff-1-x", "0x1-1-x"),
        ],
    )
    def test_survives_garbage_in_the_registry(self, name: str) -> None:
        folder = instances.registry() / name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "instance").write_bytes(b"\xff\0/../..")
        (folder / "pid").write_bytes(b"\xff9")
        assert instances.sweep() == 1
        assert not folder.exists()

    def test_survives_a_folder_without_anything_and_a_file(self) -> None:
        parent = instances.registry()
        parent.mkdir(parents=True, exist_ok=True)
        (parent / "empty").mkdir()
        (parent / "file").touch()
        try:
            instances.sweep()
            assert not (parent / "empty").exists()
        finally:
            (parent / "file").unlink(missing_ok=True)

    def test_removes_memory_of_an_engine_whose_number_nobody_knew(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        # An engine was killed while its owner waited for it, and the owner crashed.
        env = MazeEnv(LANE)
        try:
            env.reset()
            (engine,) = env.games.pids
            command = psutil.Process(engine).cmdline()
            living = command[command.index("+viz_instance_id") + 1]
            for number in (living, "Gone"):
                (tmp_path / f"ViZDoomMQDoom{number}").touch()
            (tmp_path / "another").touch()
            monkeypatch.setattr(shared_memory, "SHARED_MEMORY", tmp_path)
            instances.sweep()  # it may be starting
            assert len(list(tmp_path.iterdir())) == 3
            for name in ("_STARTING_S", "_MAKING_S"):
                monkeypatch.setattr(shared_memory, name, 0.0)
            instances.sweep()
            left = sorted(file.name for file in tmp_path.iterdir())
            assert left == [f"ViZDoomMQDoom{living}", "another"]
        finally:
            monkeypatch.undo()
            env.close()

    @pytest.mark.parametrize("sees_all", [True, False])
    def test_removes_young_memory_that_nobody_uses_where_all_can_be_seen(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *, sees_all: bool
    ) -> None:
        monkeypatch.setattr(shared_memory, "SHARED_MEMORY", tmp_path)
        monkeypatch.setattr(shared_memory, "_MAKING_S", 0.0)
        monkeypatch.setattr(shared_memory, "_sees_all_processes", lambda: sees_all)
        names = ["ViZDoomMQDoomGone", "ViZDoomMQDoomUsed"]
        for name in names:
            (tmp_path / name).write_bytes(bytes(mmap.PAGESIZE))
        with (
            (tmp_path / names[1]).open("r+b") as file,
            mmap.mmap(file.fileno(), 0),  # by this process
        ):
            instances.sweep()
            left = sorted(file.name for file in tmp_path.iterdir())
        assert left == (names[1:] if sees_all else names)

    def test_of_no_registry_is_nothing(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr(instances, "registry", lambda: tmp_path / "none")
        assert instances.sweep() == 0

    def test_leaves_alone_what_is_not_ours(self) -> None:
        name = shared_memory.SHARED_MEMORY / "ViZDoomSMnobody-knows"
        name.touch()
        try:
            instances.sweep()
            assert name.exists()
        finally:
            name.unlink()


class TestFork:
    @pytest.mark.slow
    @pytest.mark.parametrize(
        "ending", ["os._exit(0)", "sys.exit(0)"], ids=["_exit", "exit"]
    )
    def test_a_child_that_drops_the_mazes_leaves_them_to_the_parent(
        self, ending: str
    ) -> None:
        child = Child(
            ENV
            + f"""
import gc
child = os.fork()
if child == 0:
    del env
    gc.collect()
    {ending}
status = os.waitpid(child, 0)[1]
assert status == 0, status
env.rollout(3)
report(env)
print("rolled")
env.close()
"""
        )
        assert len(child.engines()) == 2
        child.go_on()
        code, output, errors = child.wait()
        assert (code, output) == (0, "rolled\n"), errors
        assert child.engines() == []

    @pytest.mark.slow
    def test_a_child_can_start_its_own(self) -> None:
        output = run(
            ENV
            + """
from toponav.envs.batched_games import BatchedGames
from toponav.envs.engines import load_engine
from toponav.envs.scene import SceneRules
child = os.fork()
if child == 0:
    try:
        env.rollout(1)
    except Exception as error:
        print("refused:", error, flush=True)
    # Without torch, whose own threads a fork does not copy either.
    own = BatchedGames(
        load_engine("vizdoom"), LANE, 2, rules=SceneRules(), episode_length=9
    )
    own.reset([0, 1])
    own.step([0, 2])
    own.close()
    print("own", flush=True)
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
env.rollout(3)
env.close()
"""
        )
        assert output == (
            "refused: a forked process must make mazes of its own, got its "
            "parent's\nown\n"
        )


def test_a_claimed_folder_holds_what_the_engine_must_not_write() -> None:
    folder = instances.claim()
    try:
        ini = instances.ini_path(folder).read_text()
        for game in ("Doom", "Heretic", "Hexen", "Strife", "Chex"):
            assert f"[{game}.AutoExec]" in ini
        assert folder.stat().st_mode & 0o077 == 0
    finally:
        instances.release(folder)
    instances.release(folder)  # twice is harmless
    assert instances.engine_pid(folder) is None


def test_engines_start_and_end_without_a_look_at_all_processes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Each of a thousand engines would look at the other thousand's.
    instances.sweep_if_due()
    monkeypatch.setattr(instances, "_SWEEP_EVERY_S", 1000.0)
    monkeypatch.setattr(psutil, "process_iter", lambda *_: pytest.fail("all of them"))
    env = MazeEnv(LANE, batch_size=2)
    pids = env.games.pids
    env.close()
    assert len(set(pids)) == 2
    assert ends(lambda: [pid for pid in pids if psutil.pid_exists(pid)])


def test_a_sweep_is_due_once_in_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    swept = list[float]()
    monkeypatch.setattr(instances, "sweep", lambda: swept.append(time.monotonic()))
    monkeypatch.setattr(instances, "_swept", -math.inf)
    for _ in range(3):
        instances.sweep_if_due()
    assert len(swept) == 1
    monkeypatch.setattr(instances, "_swept", time.monotonic() - 1.1)
    instances.sweep_if_due()
    assert len(swept) == 2


@pytest.mark.parametrize(
    "pid",
    [pytest.param(str(os.getpid()), id="own"), "99999999", f"{10**60}", "-1"],
)
def test_a_noted_number_that_is_not_the_engines_is_left_alone(pid: str) -> None:
    # This process: a number may be given again once its engine has ended.
    folder = instances.claim()
    (folder / "pid").write_text(pid)
    assert instances.engine_pid(folder) is None
    instances.release(folder)
    assert not folder.exists()


@pytest.mark.parametrize("which", ["SHARED_MEMORY", "TMPDIR"])
def test_a_machine_without_room_for_engines_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, which: str
) -> None:
    instances.check_room()
    place = tmp_path / "gone"
    if which == "TMPDIR":
        monkeypatch.setattr(instances.tempfile, "tempdir", str(place))
    else:
        monkeypatch.setattr(instances, which, place)
    with pytest.raises(
        EngineError, match=r"gone.* must have room for .* got none \(No"
    ):
        instances.check_room()
    place.mkdir()
    usage = namedtuple("Usage", "free")
    monkeypatch.setattr(
        instances.shutil,
        "disk_usage",
        lambda at: usage(9 * 1024 if at == place else 10**9),
    )
    with pytest.raises(EngineError, match=r"gone.* kB of the engine's, got 9 kB"):
        instances.check_room()
