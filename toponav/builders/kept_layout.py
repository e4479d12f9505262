"""`keep_layout`: a copy of a layout file, by which one that was edited is noticed."""

from pathlib import Path

from toponav.config import MazeConfig, SettingsError, require
from toponav.envs import Layout
from toponav.runs import LAYOUT_FILE, write_text


def keep_layout(folder: Path, maze: MazeConfig, layout: Layout | None) -> None:
    """Copy a layout of one's own beside a new run's settings; compare a resumed run's.

    Other mazes are told by their settings, and nothing is kept of them.

    Raises:
        SettingsError: if the file was edited since the run began, or the copy is no
            text.
    """
    if layout is None or maze.name != "file":
        return
    if (kept := kept_layout(folder)) is None:
        write_text(_path(folder), layout_text(layout))
        return
    rule = "resume must name a run whose layout is as it was when it began"
    require(kept == layout_text(layout), rule, edited(folder, maze))


def kept_layout(folder: Path) -> str | None:
    """What `layout_text` was when a run began; ``None`` if nothing is kept of it.

    Raises:
        SettingsError: if it is no text.
    """
    path = _path(folder)
    if not path.is_file():
        return None
    rule = "a run folder must hold its layout as text, got the damaged"
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as bad:
        raise SettingsError(f"{rule} {path} ({bad})") from bad


def layout_text(layout: Layout) -> str:
    """A layout as text whose lines end alike, whatever its file had."""
    return "\n".join(layout.rows) + "\n"


def edited(folder: Path, maze: MazeConfig) -> str:
    """What a refusal says of a layout file that was edited since a run began."""
    copy = f"{_path(folder)} is a copy of what it was"
    return f"'{maze.path}', which was edited since ({copy})"


def _path(folder: Path) -> Path:
    return folder / "config" / LAYOUT_FILE
