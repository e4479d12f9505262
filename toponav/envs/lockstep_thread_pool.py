"""Threads that do one job on many things, round by round."""

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from queue import Empty, SimpleQueue

# Seconds to wait for a thread's current item when a round is interrupted.
_PATIENCE = 0.1

# A job, the items left of its round, and where threads say that they are done with it.
_Done = SimpleQueue[BaseException | None]
_Round = tuple[Callable[[int], None], Iterator[int], _Done]


class LockstepThreadPool:
    """A pool of ``size`` threads that works in rounds.

    A round costs two queue entries a thread; an executor's futures cost several times
    as much, which shows at thousands of rounds a second.

    Examples:
        >>> pool, seen = LockstepThreadPool(2), []
        >>> pool.run(seen.append, range(3))
        >>> sorted(seen)
        [0, 1, 2]
        >>> pool.close()
    """

    def __init__(self, size: int) -> None:
        self._rounds: SimpleQueue[_Round | None] = SimpleQueue()
        # Each thread holds its own while it works.
        self._at_work = [threading.Lock() for _ in range(size)]
        # Items of the round that runs, or that was interrupted.
        self._left: Iterator[int] | None = None
        self._threads = [
            threading.Thread(target=_work, args=(self._rounds, lock), daemon=True)
            for lock in self._at_work
        ]
        for thread in self._threads:
            thread.start()

    def run(self, job: Callable[[int], None], items: Iterable[int]) -> None:
        """Do a job on every item; the first failure is raised after the round.

        After an interrupted round it first waits until nobody is at that one any more.
        """
        if self._left is not None:
            self._wait_for_interrupted(self._left)
        # A list's iterator hands each item out once, whoever asks.
        left = self._left = iter(list(items))
        # A new one each round: an interrupted round leaves entries behind.
        done: _Done = SimpleQueue()
        try:
            for _ in self._threads:
                self._rounds.put((job, left, done))
            failures = [done.get() for _ in self._threads]
        except BaseException:  # Ctrl-C: nobody takes another item
            for _ in left:
                pass
            with suppress(Empty):
                for _ in self._threads:
                    done.get(timeout=_PATIENCE)
            raise
        self._left = None
        for failure in filter(None, failures):
            raise failure

    def _wait_for_interrupted(self, left: Iterator[int]) -> None:
        for _ in left:  # those that a second Ctrl-C has kept from being dropped
            pass
        for lock in self._at_work:
            with lock:
                pass

    def close(self) -> None:
        """End the threads."""
        for _ in self._threads:
            self._rounds.put(None)
        for thread in self._threads:
            thread.join()


def _work(rounds: "SimpleQueue[_Round | None]", at_work: threading.Lock) -> None:
    while (work := rounds.get()) is not None:
        job, left, done = work
        with at_work:
            try:
                for item in left:
                    job(item)
                done.put(None)
            except BaseException as error:
                done.put(error)
