"""Where the networks compute, and in which precision."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import torch

from toponav.config import SettingsError


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
    """Whether the device multiplies bfloat16 faster than float32.

    Elsewhere bfloat16 is emulated: correct, but many times slower.
    """
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
