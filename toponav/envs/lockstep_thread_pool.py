"""Threads that do one job on many things, round by round."""

import threading
from collections.abc import Callable, Iterable, Iterator

# Seconds between two looks at whether a thread has ended.
_PATIENCE = 0.1


class LockstepThreadPool:
    """A pool of so many threads that does a whole round of work at a time.

    A round costs two semaphores a thread; an executor's futures cost several times as
    much for each item, which shows at thousands of rounds a second.

    Examples:
        >>> pool, seen = LockstepThreadPool(2), []
        >>> pool.run(seen.append, range(3))
        >>> sorted(seen)
        [0, 1, 2]
        >>> pool.close()
    """

    def __init__(self, size: int) -> None:
        if size < 1:
            raise ValueError(f"num_threads must be at least 1, got {size}")
        self._job: Callable[[int], None] | None = None
        self._items: Iterator[int] = iter(())
        self._failures: list[BaseException] = []
        self._finished = threading.Semaphore(0)
        self._starts = [threading.Semaphore(0) for _ in range(size)]
        self._threads = [
            threading.Thread(target=self._work, args=(start,), daemon=True)
            for start in self._starts
        ]
        for thread in self._threads:
            thread.start()

    def run(self, job: Callable[[int], None], items: Iterable[int]) -> None:
        """Do a job on every item; the first failure is raised after the round."""
        # A list's iterator hands each item out once, whoever asks.
        self._job, self._items = job, iter(list(items))
        # A new one each round: an interrupted round leaves a wrong count behind.
        self._finished = threading.Semaphore(0)
        try:
            for start in self._starts:
                start.release()
            for _ in self._starts:
                self._finished.acquire()
        except BaseException:  # Ctrl-C: nobody takes another item
            for _ in self._items:
                pass
            for _ in self._starts:
                self._finished.acquire(timeout=_PATIENCE)
            raise
        if self._failures:
            failure, self._failures = self._failures[0], []
            raise failure

    def close(self) -> None:
        """End the threads; items of an interrupted round are left undone."""
        self._items = iter(())
        for thread in self._threads:
            while thread.is_alive():
                self._job = None
                for start in self._starts:
                    start.release()
                thread.join(_PATIENCE)

    def _work(self, start: threading.Semaphore) -> None:
        while True:
            start.acquire()
            job, finished = self._job, self._finished
            if job is None:
                return
            try:
                for item in self._items:
                    job(item)
            except BaseException as error:
                self._failures.append(error)
            finished.release()
