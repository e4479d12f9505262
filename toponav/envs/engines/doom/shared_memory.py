"""Shared memory of engines, and what is left of it by those that nobody knew."""

import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

#: Where the engines keep their shared memory (Linux).
SHARED_MEMORY = Path("/dev/shm")
#: What an engine uses of it: of three files, as many blocks as have been written.
SHARED_BYTES = 96 * 1024
_PREFIXES = ("ViZDoomSM", "ViZDoomMQCtr", "ViZDoomMQDoom")
# An engine that has not started after so many seconds does not start any more.
_STARTING_S = 120.0
# Between the making of a file and its use lie microseconds.
_MAKING_S = 2.0
#: Number of Linux's first process namespace; who is in it sees all processes.
_FIRST_NAMESPACE = 0xEFFFFFFC


def remove_memory(identifier: str) -> None:
    """Remove the files of an engine by its own instance number."""
    for prefix in _PREFIXES:
        with suppress(OSError, ValueError):
            (SHARED_MEMORY / f"{prefix}{identifier}").unlink()


def remove_nameless(commands: Sequence[list[str]]) -> None:
    """Remove shared memory of engines that died before anybody knew their number.

    That of other users stays, and what a process uses. Where not all processes can be
    seen, as in a container that shares its memory with others, what is so young stays
    that its engine may be starting. ``commands`` are the command lines of all processes
    that can be.
    """
    living = tuple(one for one in map(instance_of, commands) if one is not None)
    files = [one for kind in _PREFIXES for one in SHARED_MEMORY.glob(f"{kind}*")]
    files = [one for one in files if not one.name.endswith(living)]
    if not files:
        return
    used = _mapped_files() if _sees_all_processes() else None
    for file in files:
        with suppress(OSError):
            state = file.stat()
            patience = _STARTING_S if used is None else _MAKING_S
            is_used = used is not None and str(file) in used
            is_young = time.time() - state.st_ctime < patience
            if state.st_uid == os.getuid() and not is_used and not is_young:
                file.unlink()


def instance_of(command: list[str]) -> str | None:
    """The engine's own instance number, which its command line has."""
    words = iter(command)
    return next(words, None) if "+viz_instance_id" in words else None


def _sees_all_processes() -> bool:
    with suppress(OSError):
        return Path("/proc/self/ns/pid").stat().st_ino == _FIRST_NAMESPACE
    return False


def _mapped_files() -> set[str]:
    """Files in the memory of this user's processes."""
    found = set[str]()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):  # it has ended, or is somebody else's
            lines = maps.read_text(errors="replace").splitlines()
            found.update(line.split(maxsplit=5)[5] for line in lines if "/" in line)
    return found
