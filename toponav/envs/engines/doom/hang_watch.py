"""Engines that hang are ended, so that the call that waits for one comes back.

A process that was stopped from outside, or waits without end, answers no call, and no
call of ViZDoom has a time limit. A thread looks now and then at the engines that are
waited for; one that took no processor time for long is killed, which ViZDoom notices at
once.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from toponav.envs.engines.doom import instances

# Two minutes, in looks: a process that was stopped as a whole, as by Ctrl-Z, and goes
# on later has not looked meanwhile. A decision takes a millisecond of a processor, and
# where others take nearly all of it still less than a look.
_LOOK_S, _LOOKS = 10.0, 12

# Folders of engines that are waited for, and since when.
_calls = dict[Path, float]()
_thread: threading.Thread | None = None


def start_watch() -> None:
    """Let a thread of this process watch its engines, if none does."""
    global _thread
    # That of a process that was forked does not live in the fork.
    if _thread is None or not _thread.is_alive():
        _thread = threading.Thread(target=_watch, daemon=True, name="engine-watch")
        _thread.start()


def kill_engine(folder: Path) -> None:
    """End the engine of a folder, whatever it does."""
    with suppress(psutil.Error):
        if (pid := instances.engine_pid(folder)) is not None:
            psutil.Process(pid).kill()


def forget_calls() -> None:
    """In a forked child: the parent's calls are not its own."""
    _calls.clear()


@contextmanager
def waiting_for(folder: Path) -> Iterator[None]:
    """Have the engine of a folder ended if it hangs in the block."""
    _calls[folder] = time.monotonic()
    try:
        yield
    finally:
        _calls.pop(folder, None)


def _watch() -> None:
    seen = dict[Path, tuple[tuple[float, float], int]]()
    while True:
        time.sleep(_LOOK_S)
        calls = _calls.copy()
        seen = {folder: seen[folder] for folder in calls.keys() & seen.keys()}
        for folder, began in calls.items():
            state = began, instances.seconds_worked(folder)
            before, looks = seen.get(folder, (None, 0))
            looks = looks + 1 if state == before else 0
            seen[folder] = state, looks
            if looks >= _LOOKS:
                kill_engine(folder)
