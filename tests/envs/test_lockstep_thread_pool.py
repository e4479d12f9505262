"""Threads that work in rounds."""

import queue
import threading
import time

import pytest

from toponav.envs import lockstep_thread_pool
from toponav.envs.lockstep_thread_pool import LockstepThreadPool


def test_every_item_is_done_once_before_a_round_ends() -> None:
    pool = LockstepThreadPool(4)
    try:
        for length in (0, 1, 3, 100):
            seen: list[int] = []
            pool.run(seen.append, range(length))
            assert sorted(seen) == list(range(length))
    finally:
        pool.close()


def test_a_failure_is_raised_and_the_next_round_works() -> None:
    pool, seen = LockstepThreadPool(2), []

    def fail(item: int) -> None:
        if item == 1:
            raise KeyError("mine")

    try:
        with pytest.raises(KeyError, match="mine"):
            pool.run(fail, range(4))
        pool.run(seen.append, range(4))
        assert len(seen) == 4
    finally:
        pool.close()


def test_the_round_after_an_interrupted_one_waits_for_its_own_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Ctrl-C while the main thread waits; the other threads go on for a moment.
    pool, seen = LockstepThreadPool(2), []

    class Interrupted(queue.SimpleQueue):
        interrupts = 1

        def get(self, block: bool = True, timeout: float | None = None):
            if self.interrupts:
                self.interrupts = 0
                raise KeyboardInterrupt
            return super().get(block, timeout)

    def slow(item: int) -> None:
        time.sleep(0.05)
        seen.append(item)

    try:
        monkeypatch.setattr(lockstep_thread_pool, "SimpleQueue", Interrupted)
        with pytest.raises(KeyboardInterrupt):
            pool.run(slow, range(100))
        monkeypatch.undo()
        assert len(seen) <= 4  # the rest was dropped
        seen.clear()
        pool.run(slow, range(6))
        assert sorted(seen) == list(range(6))
    finally:
        pool.close()


def test_close_ends_the_threads_and_may_be_called_twice() -> None:
    before = threading.active_count()
    pool = LockstepThreadPool(3)
    assert threading.active_count() == before + 3
    pool.close()
    pool.close()
    assert threading.active_count() == before
