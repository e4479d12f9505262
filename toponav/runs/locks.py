"""What one process has to itself, and the signals that ask a run to stop."""

import fcntl
import os
import shutil
import signal
import sys
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO

from toponav.config import SettingsError

#: What is true of a run that was stopped and can be resumed.
CONTINUES = "resume=<run folder> continues"


@contextmanager
def locked(path: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold a lock file, which falls with the process and is gone after the block.

    Args:
        path: of the file; its folder is made.
        wait: until nobody else holds it.

    Raises:
        BlockingIOError: if somebody else holds it, without ``wait``.
    """
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            # Who held it before has removed it, and its name may be another file's.
            if not is_at(path, file):
                continue
            try:
                yield
            finally:
                # While it is held, or the next one's would be removed.
                if is_at(path, file):
                    path.unlink()
            return


def is_at(path: Path, file: IO[str]) -> bool:
    """Whether an open file still has this path."""
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except FileNotFoundError:
        return False


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder's lock.

    Raises:
        SettingsError: if another process holds it.
    """
    with ExitStack() as held:
        try:
            held.enter_context(locked(folder / ".lock", wait=False))
        except BlockingIOError as error:
            raise SettingsError(
                "a run must have its folder to itself, got one that another run is "
                f"writing to: '{folder.parent}'"
            ) from error
        yield


def remove_unused(folder: Path, names: Collection[str]) -> None:
    """Remove a folder that holds nothing but these.

    Folders of the working directory that held it alone go too.
    """
    if not {path.name for path in folder.iterdir()} <= set(names):
        return
    shutil.rmtree(folder)
    remove_empty(folder.resolve().parent)


def remove_empty(folder: Path) -> None:
    """Remove a folder and those that held it alone, inside the working directory."""
    with suppress(OSError):
        for parent in (folder.absolute(), *folder.absolute().parents):
            if Path.cwd() not in parent.parents:
                break
            parent.rmdir()


class StoppedError(Exception):
    """Ends what is not worth finishing in a process that was asked to stop."""


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

    def check(self) -> None:
        """Raise `StoppedError` if the process was asked to stop."""
        if self.requested:
            raise StoppedError


@contextmanager
def stop_requests(sentence: str | None = CONTINUES) -> Iterator[StopRequest]:
    """Let a loop finish its batch before Ctrl-C or SIGTERM ends the process.

    In the block signals are only noted: look at ``requested`` between two batches. At
    its end a process that was asked to stop exits with the signal's status.

    Args:
        sentence: what is true of a run that was stopped; ``None`` to say nothing.
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
        if sentence is not None:
            print(f"stopped; {sentence}", file=sys.stderr)  # noqa: T201
        sys.exit(128 + request.requested)
