"""Whether a folder and the shared memory can take what a run will write."""

import os
import shutil
import sys
import tempfile
from pathlib import Path

import psutil

from toponav.config import SettingsError, require

#: Where processes of Linux share memory; other systems have no such folder.
SHARED_MEMORY = Path("/dev/shm")


def require_room(folder: Path, setting: str, megabytes: float) -> None:
    """Refuse a folder that cannot be written, or a disk with too little room.

    One that does not exist yet counts as the folder in which it would be made. Nothing
    is left in it.

    Args:
        folder: where files will be written.
        setting: that names it.
        megabytes: what will be written at least.

    Raises:
        SettingsError: if it cannot be.
    """
    rule = f"{setting} must name a folder that can be written to"
    nearest = next(one for one in (folder, *folder.parents) if os.path.exists(one))
    try:
        with tempfile.TemporaryFile(dir=nearest):
            free = shutil.disk_usage(nearest).free / 1e6
    except OSError as error:
        raise SettingsError(f"{rule}, got '{folder}' ({error.strerror})") from error
    rule = f"{setting} must name a folder on a disk with room for {megabytes:.0f} MB"
    require(free >= megabytes, rule, f"'{folder}' with {free:.1f} MB free")


def require_memory(megabytes: float, setting: str) -> None:
    """Refuse a setting that needs more memory than the machine has.

    Args:
        megabytes: what it will take at least.
        setting: that makes it less.

    Raises:
        SettingsError: if all of the memory is less.
    """
    total = psutil.virtual_memory().total / 1e6
    rule = (
        f"{setting} must be smaller, or the machine have {megabytes:.0f} MB of memory"
    )
    require(megabytes <= total, rule, f"{total:.0f} MB")


def require_shared_memory(megabytes: float, setting: str) -> None:
    """Refuse a machine whose processes cannot share so much memory.

    Args:
        megabytes: what they will share at least.
        setting: that makes it less.

    Raises:
        SettingsError: if there is no such memory, or too little of it.
    """
    if not sys.platform.startswith("linux"):
        return
    rule = f"{SHARED_MEMORY} must have room for {megabytes:.0f} MB, which processes of "
    rule += f"this run share (less with a smaller {setting})"
    try:
        with tempfile.TemporaryFile(dir=SHARED_MEMORY):
            free = shutil.disk_usage(SHARED_MEMORY).free / 1e6
    except OSError as error:
        raise SettingsError(f"{rule}, got none ({error.strerror})") from error
    hint = "; in Docker, --shm-size sets it"
    require(free >= megabytes, rule, f"{free:.1f} MB{hint}")
