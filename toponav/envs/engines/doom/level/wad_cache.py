"""WAD files on disk: content-addressed, written once, checked before use."""

import os
import tempfile
from pathlib import Path

import platformdirs

from toponav.envs.engines.doom.level.compile import CompiledMaze


def cache_folder() -> Path:
    """Where WADs are kept: the user's cache, or a temporary folder without one."""
    folder = Path(platformdirs.user_cache_dir("toponav")) / "wads"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        user = os.getuid() if hasattr(os, "getuid") else "user"
        folder = Path(tempfile.gettempdir()) / f"toponav-{user}" / "wads"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder


def wad_file(maze: CompiledMaze) -> Path:
    """The file that holds a compiled maze; written if it is missing or damaged.

    The content decides the name, and the file is written atomically, so many processes
    may ask at once.
    """
    path = cache_folder() / f"{maze.digest}.wad"
    if not path.exists() or path.read_bytes() != maze.wad:
        write_atomically(path, maze.wad)
    return path


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that nobody reads a part of it."""
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
    os.replace(name, path)
