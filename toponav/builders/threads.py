"""On how many threads torch computes, and on which cores."""

import ctypes
import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from time import perf_counter, process_time

import torch

#: What GNU OpenMP calls on each thread of a team.
_Call = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


#: Times a second that threads are sent from their cores, where two of them share one:
#: 320 were seen there.
_OFTEN = 50


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread for a while: many small products are faster so."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class ThreadGuard:
    """Keeps torch's threads on cores of their own while two of them share one.

    In the gradient of a convolution oneDNN's threads wait for each other without
    sleeping. Where two of them share a core, as Linux lets them for long while programs
    of another session run, each waits until the other has used up its time: an update
    of the pre-training then takes not 0.1 but 7 seconds. With a core for each it takes
    a few times as long as alone. Otherwise threads move freely, since a collecting
    process of the same run is less in their way so.

    A call was slow in this way if its threads had less processor time than all cores
    but one offer, and were sent from them more often than a few times a second: a call
    that waits for a GPU, or computes on one thread for a while, has little time too.

    Args:
        calls: so many are made on fixed cores after a slow one.

    Examples:
        >>> guard = ThreadGuard()
        >>> with guard.watch():
        ...     torch.ones(2, 2) @ torch.ones(2, 2)
        tensor([[2., 2.],
                [2., 2.]])
    """

    def __init__(self, calls: int = 50) -> None:
        self.calls = calls
        self.left = 0  # calls on fixed cores that are still to be made

    @contextmanager
    def watch(self) -> Iterator[None]:
        """One call, of at least some milliseconds."""
        began, spent, sent = perf_counter(), process_time(), _times_sent()
        with threads_apart() if self.left else nullcontext():
            yield
        took, spent = perf_counter() - began, process_time() - spent
        little = spent < (torch.get_num_threads() - 0.9) * took
        often = _times_sent() - sent > _OFTEN * took
        self.left = max(self.left - 1, 0)
        if not self.left and little and often:
            self.left = self.calls


@contextmanager
def threads_apart() -> Iterator[None]:
    """Keep each of torch's threads on a core of its own for a while.

    It takes half a millisecond to enter and leave. Nothing happens if there are not as
    many threads as cores, or if torch's threads are not those of GNU OpenMP on Linux.

    Examples:
        >>> with threads_apart():
        ...     torch.ones(2, 2) @ torch.ones(2, 2)
        tensor([[2., 2.],
                [2., 2.]])
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    openmp = _load_openmp()
    if openmp is None or not 1 < torch.get_num_threads() == len(cores):
        yield
        return
    number: Callable[[], int] = openmp.omp_get_thread_num
    _on_each_thread(openmp, lambda: os.sched_setaffinity(0, {cores[number()]}))
    try:
        yield
    finally:
        _on_each_thread(openmp, lambda: os.sched_setaffinity(0, cores))


def _times_sent() -> int:
    """How often this process has been sent from a core to let another one run."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw


def _load_openmp() -> ctypes.CDLL | None:
    """The library whose threads torch computes on, if it is that of its wheels."""
    for path in (Path(torch.__file__).parent / "lib").glob("libgomp*.so*"):
        with suppress(OSError):  # another one is in use
            return ctypes.CDLL(str(path), mode=os.RTLD_NOW | os.RTLD_NOLOAD)
    return None


def _on_each_thread(openmp: ctypes.CDLL, call: Callable[[], None]) -> None:
    """Run a call once on each thread that computes."""
    function = _Call(lambda _: call())
    openmp.GOMP_parallel(function, None, torch.get_num_threads(), 0)
