"""The geometry of a maze as UDMF text, which the engine turns into a map.

Each region of the maze is one sector with a floor of its own, and so is each slot, so
that it can be closed. Every edge between an open cell and a wall is a one-sided line
with a texture of its own; its front is on the right of its direction. Two-sided lines
stand only where two sectors meet.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from toponav.envs.engines.doom.spec import CELL_SIZE, ROOM_HEIGHT
from toponav.envs.layout import Cell, Layout

#: An edge of an open cell: the cell and the step to its neighbour.
Edge = tuple[Cell, Cell]

# Step to the neighbour -> the edge's end points, as fractions of the cell from
# its south-west corner, so that the cell lies on the right of start -> end.
_SIDES: dict[Cell, tuple[tuple[int, int], tuple[int, int]]] = {
    (-1, 0): ((0, 1), (1, 1)),
    (0, 1): ((1, 1), (1, 0)),
    (1, 0): ((1, 0), (0, 0)),
    (0, -1): ((0, 0), (0, 1)),
}
# Brightness of all sectors; below 255 the engine darkens with distance.
_LIGHT = 232


@dataclass(frozen=True)
class Surfaces:
    """Textures of wall edges, regions' floors and closed slots; each cell's region."""

    walls: Mapping[Edge, str]
    floors: Sequence[str]
    regions: Mapping[Cell, int]
    door: str


def wall_edges(layout: Layout) -> tuple[Edge, ...]:
    """All edges between an open cell and a wall, in reading order."""
    return tuple(
        (cell, step)
        for cell, step in product(layout.cells, _SIDES)
        if not layout.open_mask[_neighbour(cell, step)]
    )


def slot_tag(layout: Layout, letter: str) -> int:
    """The engine's tag of a slot's sector, from 1."""
    return list(layout.slots).index(letter) + 1


def textmap(layout: Layout, surfaces: Surfaces) -> str:
    """The ``TEXTMAP`` lump of a maze; all its ``wall_edges`` must have a texture."""
    sector_of, sectors = _sectors(layout, surfaces)
    lines: list[str] = []
    sides: list[str] = []
    vertices: dict[tuple[int, int], int] = {}

    def vertex(cell: Cell, corner: tuple[int, int]) -> int:
        x = (cell[1] + corner[0]) * CELL_SIZE
        y = (layout.shape[0] - 1 - cell[0] + corner[1]) * CELL_SIZE
        return vertices.setdefault((x, y), len(vertices))

    for cell, step in product(layout.cells, _SIDES):
        other, front = _neighbour(cell, step), len(sides)
        if not layout.open_mask[other]:
            texture = surfaces.walls[cell, step]
            sides.append(f'sector={sector_of[cell]};texturemiddle="{texture}";')
            kind = "blocking=true;"
        # From the north or west cell only, so that a line stands once.
        elif cell < other and sector_of[cell] != sector_of[other]:
            for side in (cell, other):
                texture = f'texturebottom="{surfaces.door}"'
                sides.append(f"sector={sector_of[side]};{texture};")
            kind = f"sideback={front + 1};twosided=true;"
        else:
            continue
        start, end = (vertex(cell, corner) for corner in _SIDES[step])
        lines.append(f"v1={start};v2={end};sidefront={front};{kind}")

    x, y = layout.centre(layout.cells[0], CELL_SIZE)
    blocks = {
        "linedef": lines,
        "vertex": [f"x={x};y={y};" for x, y in vertices],
        "sidedef": sides,
        "sector": sectors,
        "thing": [f"x={x};y={y};angle=0;type=1;"],
    }
    body = (f"{kind}{{{text}}}\n" for kind, texts in blocks.items() for text in texts)
    return 'namespace = "ZDoom";\n' + "".join(body)


def _sectors(layout: Layout, surfaces: Surfaces) -> tuple[dict[Cell, int], list[str]]:
    """The sector of every cell, and all sectors: one a region, then one a slot."""

    def sector(floor: str) -> str:
        return (
            f'heightfloor=0;heightceiling={ROOM_HEIGHT};texturefloor="{floor}";'
            f'textureceiling="F_SKY1";lightlevel={_LIGHT};'
        )

    sector_of = dict(surfaces.regions)
    sectors = [sector(floor) for floor in surfaces.floors]
    for letter, cell in layout.slots.items():
        sector_of[cell] = len(sectors)
        text = sector(surfaces.floors[surfaces.regions[cell]])
        sectors.append(text + f"id={slot_tag(layout, letter)};")
    return sector_of, sectors


def _neighbour(cell: Cell, step: Cell) -> Cell:
    return cell[0] + step[0], cell[1] + step[1]
