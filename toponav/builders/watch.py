"""Processes that die or hang are noticed, while they start and while they collect."""

import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tensordict import TensorDictBase
from torchrl.collectors import BaseCollector

from toponav.config import TrainingError
from toponav.envs import EngineError, end_stray_engines


class CollectionError(TrainingError):
    """The collecting processes stopped delivering, or never began."""


def start_collector(
    make: Callable[[], BaseCollector], *, max_idle_s: float
) -> BaseCollector:
    """Start collecting processes; if they cannot start, none of them is left.

    Raises:
        CollectionError: if one dies or needs longer than ``max_idle_s``.
        EngineError: if an engine cannot start.
    """
    try:
        with _watched(max_idle_s):
            return make()
    except BaseException:
        _kill_children()
        raise


def collect_batches(
    collector: BaseCollector, *, max_idle_s: float
) -> Iterator[TensorDictBase]:
    """Batches of a collector, or an error of one sentence if no more come.

    Raises:
        CollectionError: if a process dies, or no batch comes within ``max_idle_s``.
    """
    batches: Iterator[TensorDictBase] = iter(collector)
    while True:
        with _watched(max_idle_s):
            batch = next(batches)
        yield batch


@contextmanager
def _watched(max_idle_s: float) -> Iterator[None]:
    """Make the death of a child process, or too long a wait for one, an error.

    Who waits for the message of a process that died waits on while the engines of that
    process hold its pipe open, so these are ended each second. Processes that hang are
    ended after ``max_idle_s``, since nothing else would wake who waits for them.
    """
    done, hung = threading.Event(), threading.Event()
    deadline = time.monotonic() + max_idle_s

    def watch() -> None:
        while not done.wait(1.0):
            if time.monotonic() > deadline:
                hung.set()
                _kill_children()
            end_stray_engines()

    threading.Thread(target=watch, daemon=True, name="watch").start()
    try:
        yield
    except EngineError:
        raise
    except (RuntimeError, EOFError, OSError) as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0][:120]
        if hung.is_set():
            reason = f"nothing came in {max_idle_s:g} s (collect.max_idle_s)"
        raise CollectionError(
            f"the collecting processes must live as long as the run, got: {reason}"
        ) from error
    finally:
        done.set()


def _kill_children() -> None:
    for process in multiprocessing.active_children():
        process.kill()
        process.join()
    end_stray_engines()
