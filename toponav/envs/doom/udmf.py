"""The geometry of a maze as UDMF text, which the engine turns into a map.

Each region of the maze is one sector, so that it has a floor of its own; each
slot is one too, so that it can be closed. Sectors need not be connected. Every
edge between an open cell and a wall is a one-sided line of its own, so that
every edge can show another texture; its front side is on the right of its
direction. Two-sided lines stand only where two sectors meet.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from toponav.envs.doom.acs import ROOM_HEIGHT
from toponav.envs.layout import CELL_SIZE, Layout
from toponav.envs.layout_rules import Cell

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
#: Brightness of all sectors; below 255 the engine darkens with distance.
_LIGHT = 232


@dataclass(frozen=True)
class Surfaces:
    """Which texture goes where.

    Args:
        walls: texture name of every wall edge.
        floors: flat name of each region.
        regions: region index of every open cell.
        door: texture of a closed slot.
    """

    walls: Mapping[Edge, str]
    floors: Sequence[str]
    regions: Mapping[Cell, int]
    door: str


def wall_edges(layout: Layout) -> tuple[Edge, ...]:
    """All edges between an open cell and a wall, in reading order."""
    return tuple(
        (cell, step)
        for cell in layout.cells
        for step in _SIDES
        if not layout.open_mask[_neighbour(cell, step)]
    )


def slot_tag(layout: Layout, letter: str) -> int:
    """The engine's tag of a slot's sector, from 1."""
    return list(layout.slots).index(letter) + 1


def textmap(layout: Layout, surfaces: Surfaces) -> str:
    """The ``TEXTMAP`` lump of a maze.

    Args:
        layout: the maze.
        surfaces: textures; ``walls`` must hold all of ``wall_edges(layout)``.
    """
    sectors = _Sectors(layout, surfaces)
    body: list[str] = []
    vertices: dict[tuple[int, int], int] = {}
    sides: list[str] = []

    def vertex(cell: Cell, corner: tuple[int, int]) -> int:
        x = (cell[1] + corner[0]) * CELL_SIZE
        y = (layout.shape[0] - 1 - cell[0] + corner[1]) * CELL_SIZE
        return vertices.setdefault((x, y), len(vertices))

    for cell, step, back in _lines(layout, sectors):
        start, end = (vertex(cell, corner) for corner in _SIDES[step])
        front_side = len(sides)
        line = f"v1={start};v2={end};sidefront={front_side};"
        if back is None:
            texture = surfaces.walls[cell, step]
            sides.append(f'sector={sectors.of(cell)};texturemiddle="{texture}";')
            line += "blocking=true;"
        else:
            for side in (cell, back):
                sides.append(
                    f'sector={sectors.of(side)};texturebottom="{surfaces.door}";'
                )
            line += f"sideback={front_side + 1};twosided=true;"
        body.append(f"linedef{{{line}}}")
    body += [f"vertex{{x={x};y={y};}}" for x, y in vertices]
    body += [f"sidedef{{{side}}}" for side in sides]
    body += [f"sector{{{sector}}}" for sector in sectors.texts]
    x, y = layout.centre(layout.cells[0])
    body.append(f"thing{{x={x};y={y};angle=0;type=1;}}")
    return 'namespace = "ZDoom";\n' + "\n".join(body) + "\n"


class _Sectors:
    """One sector a region, then one a slot."""

    def __init__(self, layout: Layout, surfaces: Surfaces) -> None:
        self._regions = surfaces.regions
        self._slots = {cell: i for i, cell in enumerate(layout.slots.values())}
        self._num_regions = len(surfaces.floors)
        floors = [(floor, "") for floor in surfaces.floors]
        for letter, cell in layout.slots.items():
            floor = surfaces.floors[surfaces.regions[cell]]
            floors.append((floor, f"id={slot_tag(layout, letter)};"))
        self.texts = [
            f'heightfloor=0;heightceiling={ROOM_HEIGHT};texturefloor="{floor}";'
            f'textureceiling="F_SKY1";lightlevel={_LIGHT};{tag}'
            for floor, tag in floors
        ]

    def of(self, cell: Cell) -> int:
        if cell in self._slots:
            return self._num_regions + self._slots[cell]
        return self._regions[cell]


def _lines(
    layout: Layout, sectors: _Sectors
) -> Iterator[tuple[Cell, Cell, Cell | None]]:
    """Cell, step and, for a line between two sectors, the cell behind it."""
    for cell in layout.cells:
        for step in _SIDES:
            other = _neighbour(cell, step)
            if not layout.open_mask[other]:
                yield cell, step, None
            # From the north or west cell only, so that a line stands once.
            elif cell < other and sectors.of(cell) != sectors.of(other):
                yield cell, step, other


def _neighbour(cell: Cell, step: Cell) -> Cell:
    return cell[0] + step[0], cell[1] + step[1]
