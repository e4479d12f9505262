"""Run folders while a run owns them."""

import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

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
