"""Named semaphores of a program that is killed with its whole process group."""

import multiprocessing
import os
import signal
import time
from multiprocessing import resource_tracker, util
from pathlib import Path
from typing import NoReturn

import pytest

from toponav.builders import prepare_process, track_apart

MEMORY = Path("/dev/shm")


def hold_semaphores(writing: int) -> NoReturn:
    """As a run in a session of its own that is about to start processes."""
    try:
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        # The tests' tracker is not this program's.
        resource_tracker._resource_tracker._fd = None
        resource_tracker._resource_tracker._pid = None
        prepare_process(threads=1)
        locks = [multiprocessing.get_context("spawn").Lock() for _ in range(3)]
        names = [lock._semlock.name.lstrip("/") for lock in locks]
        os.write(writing, " ".join(names).encode())
        time.sleep(200)
    finally:
        os._exit(1)


@pytest.mark.skipif(not MEMORY.is_dir(), reason="semaphores have no files here")
def test_a_killed_process_group_leaves_none() -> None:
    reading, writing = os.pipe()
    if not (leader := os.fork()):
        hold_semaphores(writing)
    os.close(writing)
    names = os.read(reading, 4096).decode().split()
    os.close(reading)
    files = [MEMORY / f"sem.{name}" for name in names]
    try:
        assert [file.exists() for file in files] == 3 * [True]
    finally:
        os.killpg(leader, signal.SIGKILL)
        os.waitpid(leader, 0)
    deadline = time.monotonic() + 60
    while left := [file for file in files if file.exists()]:
        assert time.monotonic() < deadline, left
        time.sleep(0.05)


def test_a_python_that_starts_trackers_otherwise_is_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ordinary = util.spawnv_passfds
    track_apart()
    assert util.spawnv_passfds is ordinary
    monkeypatch.delattr(util, "spawnv_passfds")
    track_apart()
    assert not hasattr(util, "spawnv_passfds")
