"""Disks that are small or cannot be written, for a process that may mount them."""

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

# Of linux/sched.h and linux/mount.h.
_NEW_MOUNTS, _READ_ONLY, _DEEP, _OWN = 0x20000, 1, 1 << 14, 1 << 18
_libc = ctypes.CDLL(None, use_errno=True)


def _call(name: str, *arguments: object) -> None:
    given = [os.fsencode(one) if isinstance(one, Path) else one for one in arguments]
    if getattr(_libc, name)(*given):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


@contextmanager
def disk(place: Path, size: str, *, read_only: bool = False) -> Iterator[None]:
    """Put a disk of this size at a folder; to this process alone, and until it ends."""
    _call("unshare", _NEW_MOUNTS)
    _call("mount", None, b"/", None, _DEEP | _OWN, None)
    flags = _READ_ONLY if read_only else 0
    _call("mount", b"tmpfs", place, b"tmpfs", flags, f"size={size}".encode())
    yield


def _can_mount() -> bool:
    """Whether this user may mount, which root may on most machines; in a child."""
    child = os.fork()
    if child == 0:
        try:
            with disk(Path("/mnt"), "4k"):
                os._exit(0)
        except BaseException:
            os._exit(1)
    return os.waitpid(child, 0)[1] == 0


#: For tests that do.
needs_mounts = pytest.mark.skipif(not _can_mount(), reason="needs to mount disks")
