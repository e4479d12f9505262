"""How a process computes, and collecting processes: started, watched, stopped."""

import ctypes
import gc
import multiprocessing
import os
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from multiprocessing import resource_tracker, util
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.collectors import BaseCollector, MultiSyncCollector

from toponav.collectors import Patience
from toponav.config import SettingsError, TrainingError
from toponav.envs import EngineError, end_stray_engines

# Parameters of glibc's mallopt, from malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_MMAP_BYTES, _TRIM_BYTES = 2**28, 2**30
# Values of ONEDNN_MAX_CPU_ISA, by which users keep oneDNN to older instructions.
_ISA_WITHOUT_BF16 = {
    "SSE41",
    "AVX",
    "AVX2",
    "AVX2_VNNI",
    "AVX2_VNNI_2",
    "AVX512_CORE",
    "AVX512_CORE_VNNI",
}


def make_device(name: str, setting: str = "device") -> torch.device:
    """The device of a name of torch's, or of ``auto``: a GPU if there is one.

    ``setting`` is what named it.

    Raises:
        SettingsError: if torch does not know the name, or has no such device.

    Examples:
        >>> make_device("cpu")
        device(type='cpu')
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise SettingsError(
            f"{setting} must be auto, cpu or a GPU that this machine has, got '{name}'"
        ) from error
    return device


def make_autocast(device: torch.device, *, bf16: bool) -> AbstractContextManager[None]:
    """Computing in bfloat16 if it is wanted and fast; may be entered many times."""
    if not (bf16 and has_fast_bf16(device)):
        return nullcontext()
    return torch.autocast(device.type, dtype=torch.bfloat16)


def has_fast_bf16(device: torch.device) -> bool:
    """Whether bfloat16 is faster than float32; emulated, it is many times slower."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    if os.environ.get("ONEDNN_MAX_CPU_ISA", "").upper() in _ISA_WITHOUT_BF16:
        return False
    return device.type == "cpu" and bool(torch.cpu._is_avx512_bf16_supported())


def prepare_process(*, threads: int | None, seed: int | None = None) -> None:
    """Set how a process computes: threads (as many as cores for ``None``) and memory.

    With a ``seed`` torch's generator is seeded. What it starts has a tracker of its
    own, see `track_apart`. What it has imported is not looked through for garbage any
    more: that takes half a second, in which all of its threads wait.
    """
    torch.set_num_threads(threads or torch.get_num_threads())
    gc.freeze()
    keep_freed_memory()
    track_apart()
    if seed is not None:
        torch.manual_seed(seed)


def track_apart() -> None:
    """Start Python's resource tracker, if none runs, in a session of its own.

    It removes the named semaphores of processes that were killed, once the last of them
    is gone. As Python starts it, it is in their process group, and dies with them if
    all of that is killed: their names then stay in shared memory. A Python that starts
    it in another way than those of today leaves it where it is.
    """
    ordinary = getattr(util, "spawnv_passfds", None)
    if ordinary is None:
        return

    def spawn_apart(path: bytes, words: Sequence[str], kept: Sequence[int]) -> int:
        return subprocess.Popen(
            words, executable=path, pass_fds=kept, start_new_session=True
        ).pid

    setattr(util, "spawnv_passfds", spawn_apart)  # noqa: B010
    try:
        resource_tracker.ensure_running()
    finally:
        setattr(util, "spawnv_passfds", ordinary)  # noqa: B010


def keep_freed_memory() -> bool:
    """Let this process keep memory that it has freed, instead of returning it at once.

    Every update allocates and frees the same tens of megabytes, and by default the
    system clears and maps each page again: 30 % of the time of an update of the small
    networks. Blocks of 256 MiB and more still go back, and so does a free gigabyte at
    the end of the heap. Returns whether the C library took the setting, as glibc does.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(
        mallopt(_M_MMAP_THRESHOLD, _MMAP_BYTES)
        and mallopt(_M_TRIM_THRESHOLD, _TRIM_BYTES)
    )


def seed_of(*parts: int) -> int:
    """A seed that almost surely differs if any of the numbers does.

    Examples:
        >>> seed_of(0, 1) == seed_of(1, 0)
        False
    """
    return int(np.random.SeedSequence(parts).generate_state(1)[0] >> 1)


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
    with _watched(max_idle_s):
        return make()


def collect_batches(
    collector: BaseCollector, *, max_idle_s: float
) -> Iterator[TensorDictBase]:
    """Batches of a collector, or an error of one sentence if no more come.

    Raises:
        CollectionError: if a process dies, or one of them hands over no batch in about
            ``max_idle_s``.
    """
    batches: Iterator[TensorDictBase] = iter(collector)
    # When a batch of each process was taken last, and what counts as time so far.
    taken = dict.fromkeys(range(collector.num_workers), 0.0)
    so_far, before = 0.0, time.monotonic()
    while True:
        with _watched(max_idle_s):
            batch = next(batches)
            maker = getattr(collector, "maker", None)
            if maker is not None:
                # Batches queue up: who had one when this process began its own would
                # have come first, however long the caller was busy.
                if taken[maker] - min(taken.values()) > max_idle_s:
                    raise TimeoutError
                # All of them may have been stopped in between, as by Ctrl-Z.
                now = time.monotonic()
                so_far, before = so_far + min(now - before, max_idle_s / 2), now
                taken[maker] = so_far
        yield batch


def running_episodes(
    collector: BaseCollector, *, max_idle_s: float
) -> list[dict[str, Any]] | None:
    """What processes need to resume their episodes, between two batches.

    ``None`` for async collectors and worlds that cannot replay; raises as
    `collect_batches`.
    """
    if not isinstance(collector, MultiSyncCollector):
        return None
    with _watched(max_idle_s):
        states: list[Any] = collector.map_fn("running_episodes")
    return None if None in states else states


def stop_collector(collector: BaseCollector) -> None:
    """Shut a collector down, whatever state its processes are in.

    TorchRL then gives this process their threads too, with which small operations take
    a hundred times as long on a busy machine; it keeps its own number here. Engines of
    a process that was killed are ended.
    """
    threads = torch.get_num_threads()
    collector.shutdown(raise_on_error=False)
    torch.set_num_threads(threads)
    end_stray_engines()


@contextmanager
def _watched(max_idle_s: float) -> Iterator[None]:
    """Make the death of a child process, or too long a wait for one, an error.

    Who waits for the message of a process that died waits on while the engines of that
    process hold its pipe open, so these are ended each second. Processes that hang are
    ended after ``max_idle_s``, since nothing else would wake the waiting caller.
    """
    done, hung = threading.Event(), threading.Event()

    def watch() -> None:
        patience = Patience(max_idle_s)
        while not done.wait(1.0):
            if patience.is_over():
                hung.set()
                _kill_children()
            end_stray_engines()

    threading.Thread(target=watch, daemon=True, name="watch").start()
    try:
        yield
    except BaseException as error:
        _kill_children()
        # TorchRL appends the traceback of the process that raised.
        said = str(error).partition("\n\nWorker traceback:")[0].strip()
        if isinstance(error, (EngineError, SettingsError)):
            raise type(error)(said) from error
        # TorchRL raises this while it closes the survivors of a dead process.
        lost = isinstance(error, ValueError) and "close a process" in said
        if not (lost or isinstance(error, (RuntimeError, EOFError, OSError))):
            raise
        reason = (said or type(error).__name__).splitlines()[0][:120]
        if hung.is_set() or isinstance(error, TimeoutError):
            reason = f"nothing came in {max_idle_s:g} s (collect.max_idle_s)"
        elif lost:
            reason = "one of them died"
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
