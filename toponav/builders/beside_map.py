"""Files that belong to one writing of a map, and are found with it after any kill.

A map is replaced as a whole, but the poses of its waypoints and what knows them by
their views are files of their own. They are written first, under names with ``.next``,
and the map names the content of each; when it is in place they get their own names.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path

from toponav.builders.places import PLACES_FILE
from toponav.graph import MapFileError, load_map

#: The files in a run folder that hold the map, and where its waypoints truly are.
MAP_FILE, POSES_FILE = "map.zip", "map_poses.npy"
_BESIDE = (POSES_FILE, PLACES_FILE)


def next_path(path: Path) -> Path:
    """Where a file waits for the map to which it belongs.

    Examples:
        >>> next_path(Path("places.pt")).name
        'places.next.pt'
    """
    return path.with_name(f"{path.stem}.next{path.suffix}")


def name_contents(folder: Path) -> dict[str, str]:
    """Words for `save_map` about the files that wait in a folder; empty for none."""
    waiting = {name: next_path(folder / name) for name in _BESIDE}
    return {
        name: _digest(path) if path.is_file() else "" for name, path in waiting.items()
    }


def find_beside(folder: Path, name: str, about: Mapping[str, str]) -> Path | None:
    """The file of this name that belongs to the map of which ``about`` are the words.

    A map of an earlier version names no contents, and takes what lies beside it.
    """
    path, wanted = folder / name, about.get(name)
    for candidate in (path, next_path(path)):
        fits = candidate.is_file() and wanted in (None, _digest(candidate))
        if fits:
            return candidate
    return None


def mend_beside(folder: Path) -> None:
    """`put_beside` for a run that was killed before it could, if files still wait."""
    if not any(next_path(folder / name).exists() for name in _BESIDE):
        return
    try:
        _, about = load_map(folder / MAP_FILE)
    except MapFileError:
        # Killed before its first map was whole: nothing can belong to it.
        about = dict.fromkeys(_BESIDE, "")
    put_beside(folder, about)


def put_beside(folder: Path, about: Mapping[str, str]) -> None:
    """Give the files that wait for the map of these words their names; drop others."""
    for name in _BESIDE:
        path = folder / name
        if find_beside(folder, name, about) == (waiting := next_path(path)):
            waiting.replace(path)
        waiting.unlink(missing_ok=True)
        if about.get(name) == "":
            path.unlink(missing_ok=True)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
