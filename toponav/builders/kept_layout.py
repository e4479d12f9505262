"""`keep_layout`: a copy of a layout file, by which one that was edited is noticed."""

from pathlib import Path

from toponav.config import MazeConfig, require
from toponav.envs import Layout
from toponav.runs import LAYOUT_FILE, write_text


def keep_layout(folder: Path, maze: MazeConfig, layout: Layout | None) -> None:
    """Copy a layout of one's own beside a new run's settings; compare a resumed run's.

    Other mazes are told by their settings, and nothing is kept of them.

    Raises:
        SettingsError: if the file was edited since the run began.
    """
    if layout is None or maze.name != "file":
        return
    if (kept := kept_layout(folder)) is None:
        write_text(_path(folder), layout_text(layout))
        return
    rule = "resume must name a run whose layout is as it was when it began"
    require(kept == layout_text(layout), rule, edited(folder, maze))


def kept_layout(folder: Path) -> str | None:
    """What `layout_text` was when a run began; ``None`` if nothing is kept of it."""
    path = _path(folder)
    return path.read_text(encoding="utf-8") if path.is_file() else None


def layout_text(layout: Layout) -> str:
    """A layout as text whose lines end alike, whatever its file had."""
    return "\n".join(layout.rows) + "\n"


def edited(folder: Path, maze: MazeConfig) -> str:
    """What a refusal says of a layout file that was edited since a run began."""
    copy = f"{_path(folder)} is a copy of what it was"
    return f"'{maze.path}', which was edited since ({copy})"


def _path(folder: Path) -> Path:
    return folder / "config" / LAYOUT_FILE
