"""On how many threads torch computes, and on which cores."""

import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import torch

#: What GNU OpenMP calls on each thread of a team.
_Call = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread for a while: many small products are faster so."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def threads_apart() -> Iterator[None]:
    """Keep each of torch's threads on a core of its own for a while.

    In the gradient of a convolution oneDNN's threads wait for each other without
    sleeping. Where two of them share a core, which Linux leaves them for long while
    programs of another session run, each waits until the other has used up its time:
    an update of the pre-training then takes seconds. It takes half a millisecond to
    enter and leave. Nothing happens if there are not as many threads as cores, or if
    torch's threads are not those of GNU OpenMP on Linux.

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
