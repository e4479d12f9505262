"""From a layout and a scene to what ``level.lua`` reads."""

import hashlib
from collections.abc import Iterator, Mapping
from string import ascii_uppercase

import numpy as np
from numpy.typing import NDArray

from toponav.envs.game import Look
from toponav.envs.layout import FLOOR, WALL, Cell, Layout
from toponav.envs.regions import assign_regions
from toponav.envs.scene import Pose, Scene

# The engine's spawn point; the scene says where it is.
_SPAWN = "P"
# Names of the engine's own textures, without what they have in common.
_WALLS = (
    *("01_wall_green_bright", "01_wall_red_bright", "01_wall_cerise"),
    *("01_wall_yellow", "02_wall_blue", "03_wall_orange_bright", "03_wall_gray"),
    *("04_wall_red", "04_wall_green"),
)
_FLOORS = (
    *("01_floor_orange", "01_floor_blue", "02_floor_green", "02_floor_blue"),
    *("03_floor_green", "03_floor_blue", "04_floor_orange", "04_floor_blue"),
)
_PICTURE_STYLES, _PICTURES = (2, 3), 20
# From a cell to its neighbour on each side: rows down, columns to the right.
_SIDES = {"N": (-1, 0), "E": (0, 1), "S": (1, 0), "W": (0, -1)}


def level_settings(layout: Layout, look: Look) -> dict[str, str]:
    """How a maze looks, as settings of the level; marks are not drawn.

    It is a function of the layout and the look alone: a closed slot changes nothing but
    its own cell.
    """
    generator = np.random.default_rng(look.texture_seed)
    regions, number = assign_regions(layout, generator)
    walls, floors = generator.permutation(_WALLS), generator.permutation(_FLOORS)
    styles = [
        f"{_letter(region)} {_style(walls, region)} {_style(floors, region)}"
        for region in range(min(number, len(ascii_uppercase)))
    ]
    return {
        "regions": _region_text(layout, regions),
        "styles": "\n".join(styles),
        "pictures": "\n".join(_pictures(layout, look.paintings, generator)),
    }


def scene_text(layout: Layout, settings: Mapping[str, str], scene: Scene) -> str:
    """One episode as the level's property ``scene``, by the maze's `level_settings`."""
    rows = _rows(layout, scene.blocked)
    content = repr((rows, sorted(settings.items())))
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


def _region_text(layout: Layout, regions: Mapping[Cell, int]) -> str:
    """A letter for each open cell's region, which share walls and floors."""
    letters = [["."] * layout.shape[1] for _ in range(layout.shape[0])]
    for (row, column), region in regions.items():
        letters[row][column] = _letter(region)
    return "\n".join("".join(row) for row in letters)


def _letter(region: int) -> str:
    return ascii_uppercase[region % len(ascii_uppercase)]


def _style(names: NDArray[np.str_], region: int) -> str:
    return f"map/lab_games/lg_style_{names[region % len(names)]}"


def _pictures(
    layout: Layout, share: float, generator: np.random.Generator
) -> Iterator[str]:
    """Some sides of cells, each with the picture on the wall there."""
    sides = [
        (cell, name)
        for cell in layout.cells
        for name, (down, right) in _SIDES.items()
        if not layout.open_mask[cell[0] + down, cell[1] + right]
    ]
    order = generator.permutation(len(sides))
    for index in sorted(order[: round(share * len(sides))]):
        (row, column), side = sides[index]
        style = generator.choice(_PICTURE_STYLES)
        picture = generator.integers(1, _PICTURES + 1)
        name = f"decal/lab_games/dec_img_style{style:02}_{picture:03}_nonsolid"
        yield f"{row + 1} {column + 1} {side} {name}"  # Lua counts from 1
