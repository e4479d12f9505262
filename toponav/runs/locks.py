"""A run's hold on its folder, and the signals that ask it to stop."""

import shutil
import signal
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from filelock import FileLock, Timeout

from toponav.config import SettingsError


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder's lock, which falls with the process.

    Raises:
        SettingsError: if another process holds it.
    """
    lock = FileLock(folder / ".lock", timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise SettingsError(
            "a run must have its folder to itself, got one that another run is "
            f"writing to: '{folder.parent}'"
        ) from error
    try:
        yield
    finally:
        lock.release()


def remove_unused(folder: Path, names: Collection[str]) -> None:
    """Remove a folder that holds nothing but these.

    Folders of the working directory that held it alone go too.
    """
    if not {path.name for path in folder.iterdir()} <= set(names):
        return
    shutil.rmtree(folder)
    with suppress(OSError):
        for parent in folder.resolve().parents:
            if Path.cwd() not in parent.parents:
                break
            parent.rmdir()


class StopRequest:
    """Whether Ctrl-C or SIGTERM asked a run to stop."""

    def __init__(self) -> None:
        #: Number of the signal, 0 without one.
        self.requested = 0

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal: the first one asks, the same once more insists.

        Ctrl-C reaches a run and the run that started it, which then sends SIGTERM.
        """
        if self.requested == number:
            sys.exit(128 + number)
        self.requested = self.requested or number


@contextmanager
def stop_requests() -> Iterator[StopRequest]:
    """Let a loop finish its batch before Ctrl-C or SIGTERM ends the process.

    In the block signals are only noted: look at ``requested`` between two batches. At
    its end a process that was asked to stop exits with the signal's status.
    """
    request = StopRequest()
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, request) for number in numbers}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if request.requested:
        print("stopped; resume=<run folder> continues", file=sys.stderr)  # noqa: T201
        sys.exit(128 + request.requested)
