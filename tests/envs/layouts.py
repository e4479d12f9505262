"""Layouts to test with, and ways to draw more."""

from collections import deque

from hypothesis import strategies as st

from toponav.envs import Layout, LayoutError, make_random_layout
from toponav.envs.layout import Cell

#: A room of 3 x 1 cells, one of 3 x 3 cells, and a ring with two slots.
LANE = Layout("*****\n*   *\n*****", name="lane")
HALL = Layout("*****\n*   *\n*   *\n*   *\n*****", name="hall")
RING = Layout("*****\n*   *\n*a*b*\n*   *\n*****", name="ring")
#: Ten cells in a row, to walk along.
TRACK = Layout("************\n*          *\n************", name="track")
#: A ring of 3 x 4 cells whose slot lies in the southern corridor.
GATE = Layout("******\n*    *\n* ** *\n* a  *\n******", name="gate")


def steps_from(layout: Layout, source: Cell, closed: str = "") -> dict[Cell, int]:
    """Geodesic distances by plain breadth-first search: the oracle."""
    shut = {layout.slots[letter] for letter in closed}
    found, queue = {source: 0}, deque([source])
    while queue:
        row, column = queue.popleft()
        for step in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            cell = (row + step[0], column + step[1])
            is_open = layout.rows[cell[0]][cell[1]] != "*" and cell not in shut
            if is_open and cell not in found:
                found[cell] = found[row, column] + 1
                queue.append(cell)
    return found


@st.composite
def random_layouts(draw: st.DrawFn) -> Layout:
    """Layouts of the package's own generator."""
    return make_random_layout(
        draw(st.integers(1, 7)),
        draw(st.integers(1, 7)),
        seed=draw(st.integers(0, 2**32)),
        loops=draw(st.floats(0.0, 1.0)),
    )


@st.composite
def drawn_layouts(draw: st.DrawFn) -> Layout:
    """Layouts drawn cell by cell: the part around one cell of a random picture.

    Odd ones too: halls, single cells, diagonal walls, slots side by side.
    """
    rows, columns = draw(st.integers(1, 7)), draw(st.integers(1, 7))
    line = st.text("*   ", min_size=columns, max_size=columns)
    picture = [
        list(line) for line in draw(st.lists(line, min_size=rows, max_size=rows))
    ]
    row, column = draw(st.integers(0, rows - 1)), draw(st.integers(0, columns - 1))
    picture[row][column] = " "
    framed = ["*" * (columns + 2), *(f"*{''.join(r)}*" for r in picture)]
    framed.append("*" * (columns + 2))
    kept = _part_around(framed, (row + 1, column + 1))
    letters = iter(draw(st.sampled_from(["", "a", "za", "abc"])))
    for letter in letters:
        cell = draw(st.sampled_from(sorted(kept)))
        with_slot = {**kept, cell: letter}
        if _is_layout(_text(framed, with_slot)):
            kept = with_slot
    return Layout(_text(framed, kept), name="drawn")


def _part_around(rows: list[str], cell: Cell) -> dict[Cell, str]:
    kept, queue = {cell: " "}, deque([cell])
    while queue:
        row, column = queue.popleft()
        for other in (
            *((row - 1, column), (row + 1, column)),
            *((row, column - 1), (row, column + 1)),
        ):
            if rows[other[0]][other[1]] == " " and other not in kept:
                kept[other] = " "
                queue.append(other)
    return kept


def _text(rows: list[str], kept: dict[Cell, str]) -> str:
    return "\n".join(
        "".join(kept.get((r, c), "*") for c in range(len(row)))
        for r, row in enumerate(rows)
    )


def _is_layout(text: str) -> bool:
    try:
        Layout(text)
    except LayoutError:
        return False
    return True
