"""From a layout and a scene to what ``level.lua`` reads."""

import hashlib
from string import ascii_uppercase

import numpy as np

from toponav.envs.game import Look
from toponav.envs.layout import FLOOR, WALL, Layout
from toponav.envs.regions import assign_regions
from toponav.envs.scene import Pose, Scene

# The engine's spawn point; the scene says where it is.
_SPAWN = "P"


def level_settings(layout: Layout, look: Look) -> dict[str, str]:
    """How a maze looks, as settings of the level."""
    return {
        "regions": _region_text(layout, look),
        "textureSeed": str(look.texture_seed % 2**31),
        "decals": repr(look.paintings),
    }


def scene_text(layout: Layout, look: Look, scene: Scene) -> str:
    """One episode as the level's property ``scene``."""
    rows = _rows(layout, scene.blocked)
    content = repr((rows, sorted(level_settings(layout, look).items())))
    name = "tn" + hashlib.sha256(content.encode()).hexdigest()[:16]
    lines = [f"map {name}", *(f"row {row}" for row in rows)]
    lines.append(f"start {pose_text(scene.start)}")
    if scene.goal is not None:
        lines.append(f"goal {_numbers(*scene.goal)}")
    lines += [f"apple {_numbers(*place)}" for place in scene.apples]
    return "\n".join(lines)


def pose_text(pose: Pose) -> str:
    """A pose as the level reads it."""
    return _numbers(*pose)


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.4f}" for value in values)


def _rows(layout: Layout, blocked: tuple[str, ...]) -> list[str]:
    """The text level: walls, also for closed slots, floor, and one spawn point."""
    rows = []
    for row in layout.rows:
        for letter in filter(str.isalpha, row):
            row = row.replace(letter, WALL if letter in blocked else FLOOR)
        rows.append(row)
    line = next(number for number, row in enumerate(rows) if FLOOR in row)
    rows[line] = rows[line].replace(FLOOR, _SPAWN, 1)
    return rows


def _region_text(layout: Layout, look: Look) -> str:
    """A letter for each open cell's region, which share walls and floors."""
    generator = np.random.default_rng(look.texture_seed)
    regions, _ = assign_regions(layout, generator)
    letters = [["."] * layout.shape[1] for _ in range(layout.shape[0])]
    for (row, column), region in regions.items():
        letters[row][column] = ascii_uppercase[region % len(ascii_uppercase)]
    return "\n".join("".join(row) for row in letters)
