"""Where engines keep what they compile, from one process to the next."""

import os
import tempfile
from pathlib import Path

import platformdirs


def cache_folder(name: str) -> Path:
    """A folder in the user's cache, or without one in a temporary folder.

    Examples:
        >>> cache_folder("wads").name
        'wads'
    """
    folder = Path(platformdirs.user_cache_dir("toponav")) / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        user = os.getuid() if hasattr(os, "getuid") else "user"
        folder = Path(tempfile.gettempdir()) / f"toponav-{user}" / name
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder
