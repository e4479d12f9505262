"""How a process computes: device, precision, threads, memory, seeds, its end."""

import ctypes
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import numpy as np
import torch
from torchrl.collectors import BaseCollector

from toponav.config import SettingsError
from toponav.envs import end_stray_engines

# Parameters of glibc's mallopt, from malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_MMAP_BYTES, _TRIM_BYTES = 2**28, 2**30


def make_device(name: str) -> torch.device:
    """The device of a name of torch's, or of ``auto``: a GPU if there is one.

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
            f"device must be auto, cpu or a GPU that this machine has, got '{name}'"
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
    return device.type == "cpu" and bool(torch.cpu._is_avx512_bf16_supported())


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread for a while: many small products are faster so."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def keep_freed_memory() -> bool:
    """Let this process keep memory that it has freed, instead of returning it at once.

    Every update allocates and frees the same tens of megabytes, and by default the
    system clears and maps each page again: 72,000 page faults and 30 % of the time of
    an update of the small networks, 450 faults and under 1 % after this call. Blocks of
    256 MiB and more still go back, and so does a free gigabyte at the end of the heap.

    Returns:
        Whether the C library took the setting; glibc does, others need not.
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
    """A seed that differs, as good as surely, if any of the numbers does.

    Examples:
        >>> seed_of(0, 1) == seed_of(1, 0)
        False
    """
    return int(np.random.SeedSequence(parts).generate_state(1)[0] >> 1)


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
