"""What every test stands on: one thread, folders of its own, nothing left behind."""

import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from datetime import date
from pathlib import Path

import psutil
import pytest
import torch
from hypothesis import settings

from tests.explored import Explored, make_run, navigate_settings
from tests.stand_in_device import NAME, StandInDevice
from toponav.builders import load_exploration
from toponav.envs.engines.doom import instances

torch.set_num_threads(1)
# No deadline: a busy machine makes an example late, not wrong. The same examples each
# time where a change is judged (CI), new ones where it is made.
settings.register_profile("toponav", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("toponav")
#: Where a change is judged (CI), no slow test starts later than this many seconds after
#: its session: all fit on most machines, and a slower one names those that it left out.
#: No other test starts later than the second number: a core without AVX-512 may need
#: longer for all, and a verdict is due within a quarter of an hour.
_SLOW_START_WITHIN_S, _START_WITHIN_S = 570, 660
_BEGAN = time.monotonic()
_DAY = "TOPONAV_TESTS_DAY"
#: Names of devices that are not the processor.
DEVICES = [
    NAME,
    pytest.param(
        "cuda",
        marks=[
            pytest.mark.gpu,
            pytest.mark.skipif(
                not torch.cuda.is_available(), reason="needs a CUDA device"
            ),
        ],
    ),
]


def pytest_configure() -> None:
    """Every worker of pytest-xdist takes the day of the process that starts it.

    Ctrl-C is heard also where the tests run in a background that ignores it: programs
    that they start would ignore it, too.
    """
    os.environ.setdefault(_DAY, str(date.today().toordinal()))
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests come last, where a change is judged from another third on each day."""
    fast = [item for item in items if not _is_slow(item)]
    slow = [item for item in items if _is_slow(item)]
    # Where not all fit, not always the same ones are left out.
    first = int(os.environ[_DAY]) % 3 * len(slow) // 3 if "CI" in os.environ else 0
    items[:] = fast + slow[first:] + slow[:first]


def pytest_runtest_setup(item: pytest.Item) -> None:
    limit = _SLOW_START_WITHIN_S if _is_slow(item) else _START_WITHIN_S
    if "CI" in os.environ and time.monotonic() - _BEGAN > limit:
        pytest.skip(f"{limit} s of this run are over")


def _is_slow(item: pytest.Item) -> bool:
    return item.get_closest_marker("slow") is not None


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> Iterator[str]:
    """The name of a device that is not the processor."""
    if request.param == NAME:
        with StandInDevice():
            yield NAME
    else:
        # Its convolutions round to TF32 otherwise, and tests compare with a processor.
        flags = {"enabled": True, "benchmark": False, "deterministic": False}
        with torch.backends.cudnn.flags(**flags, allow_tf32=False):
            yield request.param


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of an exploration of a ring, of networks never trained."""
    path = tmp_path_factory.mktemp("explored") / "run"
    make_run(path)
    return path


@pytest.fixture(scope="module")
def explored(folder: Path) -> Explored:
    """What it found."""
    return load_exploration(navigate_settings(folder))


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """TorchRL's collectors of several processes leave this one with other threads.

    Sessions side by side with several threads each get in each other's way.
    """
    yield
    torch.set_num_threads(1)


@pytest.fixture(scope="session", autouse=True)
def private_folders() -> Iterator[Path]:
    """Engines and WADs of this session, its child processes included, in one place.

    Fails the session if an engine process or shared memory of ours is left.
    """
    folder = Path(tempfile.mkdtemp(prefix="toponav-tests-"))
    before = dict(os.environ)
    os.environ["TMPDIR"] = str(folder)
    os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
    tempfile.tempdir = None
    started: list[str] = []
    note_instance = instances.note_instance

    def note(claimed: Path, instance_id: str) -> None:
        started.append(instance_id)
        note_instance(claimed, instance_id)

    instances.note_instance = note
    yield folder
    instances.note_instance = note_instance
    # Engines of a process that a test has killed by SIGKILL wait for the next start.
    instances.sweep()
    # The last test's engines may still be dying, and a zombie is waited for by whoever
    # took it over.
    _, engines = psutil.wait_procs(_processes_naming(folder), timeout=30)
    engines = [engine for engine in engines if _runs(engine)]
    commands = [engine.info["cmdline"] for engine in engines]
    for engine in engines:
        engine.kill()
    memory = [path.name for path in Path("/dev/shm").glob("ViZDoom*")]
    os.environ.clear()
    os.environ.update(before)
    tempfile.tempdir = None
    shutil.rmtree(folder, ignore_errors=True)
    assert not engines, f"the tests must end all engines, got {commands} left"
    left = [name for name in memory if any(name.endswith(end) for end in started)]
    assert not left, f"the tests must leave no shared memory, got {left}"


def _processes_naming(folder: Path) -> list[psutil.Process]:
    return [
        process
        for process in psutil.process_iter(["cmdline"])
        if any(
            str(folder) in word and word.endswith("engine.ini")
            for word in process.info["cmdline"] or []
        )
    ]


def _runs(process: psutil.Process) -> bool:
    try:
        return process.status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    except psutil.NoSuchProcess:
        return False
