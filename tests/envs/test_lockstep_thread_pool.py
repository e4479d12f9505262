"""Threads that work in rounds."""

import queue
import threading
import time
from collections.abc import Callable, Iterable

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


def interrupt(
    pool: LockstepThreadPool,
    job: Callable[[int], None],
    items: Iterable[int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A round in which Ctrl-C reaches the main thread when another one is at work."""
    begun = threading.Event()

    class Interrupted(queue.SimpleQueue):
        interrupts = 1

        def get(self, block: bool = True, timeout: float | None = None):
            if self.interrupts:
                self.interrupts = 0
                assert begun.wait(60)
                raise KeyboardInterrupt
            return super().get(block, timeout)

    def begin(item: int) -> None:
        begun.set()
        job(item)

    with monkeypatch.context() as patch:
        patch.setattr(lockstep_thread_pool, "SimpleQueue", Interrupted)
        with pytest.raises(KeyboardInterrupt):
            pool.run(begin, items)


def test_the_round_after_an_interrupted_one_waits_for_its_own_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The other threads go on for a moment.
    pool, seen = LockstepThreadPool(2), []

    def slow(item: int) -> None:
        time.sleep(0.05)
        seen.append(item)

    try:
        interrupt(pool, slow, range(100), monkeypatch)
        assert len(seen) <= 4  # the rest was dropped
        seen.clear()
        pool.run(slow, range(6))
        assert sorted(seen) == list(range(6))
    finally:
        pool.close()


def test_the_round_after_an_interrupted_one_waits_for_what_is_still_at_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # An engine may take longer than an interrupted round waits for it.
    pool, events = LockstepThreadPool(2), []

    def slow(item: int) -> None:
        time.sleep(0.5)
        events.append("slow ended")

    try:
        interrupt(pool, slow, [3], monkeypatch)
        assert events == []
        pool.run(lambda item: events.append("next began"), [3])
        assert events == ["slow ended", "next began"]
        pool.run(lambda item: events.append("another"), [3])
        assert events[2:] == ["another"]
    finally:
        pool.close()


def test_close_ends_the_threads_and_may_be_called_twice() -> None:
    before = threading.active_count()
    pool = LockstepThreadPool(3)
    assert threading.active_count() == before + 3
    pool.close()
    pool.close()
    assert threading.active_count() == before
