"""Text layouts of mazes: parse, validate, measure.

A layout is a rectangle of characters: ``*`` is wall, a space is floor and a
lower-case letter is a *slot*, a floor cell that an episode can close. The first
line is the north side. One character is one cell of 128 x 128 map units; x
points east, y north, and the origin is the south-west corner of the text.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from string import ascii_lowercase

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from toponav.envs.layout_rules import WALL, Cell, LayoutError, cell_graph, check_rows

#: Side of one cell in map units.
CELL_SIZE = 128


@dataclass(frozen=True)
class Layout:
    r"""A valid maze: immutable, hashable, with its geometry worked out on demand.

    Args:
        text: the rows of the layout joined by newlines.
        name: what messages and plots call it.

    Raises:
        LayoutError: if the text is not a closed, connected rectangle of known
            letters; the message names the line and column (both from 1).

    Examples:
        >>> layout = Layout("*****\n*   *\n* *a*\n*   *\n*****", name="ring")
        >>> layout.num_cells, layout.slots
        (8, {'a': (2, 3)})
        >>> layout.distances((1, 3))[3, 3], layout.distances((1, 3), closed="a")[3, 3]
        (np.int64(2), np.int64(6))
    """

    text: str
    name: str = "maze"

    def __post_init__(self) -> None:
        check_rows(self.rows, self.name)

    @cached_property
    def rows(self) -> tuple[str, ...]:
        """The text's lines, from north to south."""
        return tuple(self.text.replace("\r\n", "\n").rstrip("\n").split("\n"))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns, the border included."""
        return len(self.rows), len(self.rows[0])

    @cached_property
    def open_mask(self) -> NDArray[np.bool_]:
        """Floor and slots, bool ``[rows, columns]``."""
        return np.array([[letter != WALL for letter in row] for row in self.rows])

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """All open cells (row, column) in reading order, slots included."""
        return tuple((int(r), int(c)) for r, c in np.argwhere(self.open_mask))

    @property
    def num_cells(self) -> int:
        """Number of open cells, slots included."""
        return len(self.cells)

    @cached_property
    def slots(self) -> Mapping[str, Cell]:
        """Slot letter -> cell, in the alphabet's order."""
        found = {
            letter: (r, c)
            for r, row in enumerate(self.rows)
            for c, letter in enumerate(row)
            if letter in ascii_lowercase
        }
        return dict(sorted(found.items()))

    def graph(self, closed: Iterable[str] = ()) -> "nx.Graph[Cell]":
        """The open cells and their four-neighbour steps, closed slots left out."""
        shut = {self.slots[letter] for letter in self.check_slots(closed)}
        return cell_graph(cell for cell in self.cells if cell not in shut)

    def distances(self, source: Cell, closed: Iterable[str] = ()) -> NDArray[np.int64]:
        """Geodesic distance in cells from ``source``, ``[rows, columns]``, -1 if none.

        Args:
            source: an open cell (row, column).
            closed: letters of the closed slots.

        Raises:
            ValueError: if a slot is unknown or ``source`` is wall or closed.
        """
        graph = self.graph(closed)
        if source not in graph:
            raise ValueError(f"source must be an open cell, got {source}")
        lengths = np.full(self.shape, -1, dtype=np.int64)
        for cell, length in nx.single_source_shortest_path_length(
            graph, source
        ).items():
            lengths[cell] = length
        return lengths

    def check_slots(self, letters: Iterable[str]) -> tuple[str, ...]:
        """The slot letters, sorted and without repeats, if they can all be closed.

        Raises:
            ValueError: if one is no slot of this layout, or if closing them all
                cuts the maze in two.
        """
        wanted = tuple(sorted(set(letters)))
        for letter in wanted:
            if letter not in self.slots:
                have = ", ".join(self.slots) or "none"
                raise ValueError(
                    f"blocked slots must be slots of {self.name} ({have}), "
                    f"got '{letter}'"
                )
        shut = {self.slots[letter] for letter in wanted}
        left = [cell for cell in self.cells if cell not in shut]
        if not left or not nx.is_connected(cell_graph(left)):
            raise ValueError(
                f"closed slots must leave {self.name} in one piece, "
                f"got {', '.join(wanted)} together"
            )
        return wanted

    def centre(self, cell: Cell) -> tuple[float, float]:
        """Map position (x, y) of a cell's centre, in map units."""
        row, column = cell
        return (column + 0.5) * CELL_SIZE, (self.shape[0] - row - 0.5) * CELL_SIZE

    def cell_of(self, x: float, y: float) -> Cell:
        """The cell (row, column) in which a map position lies."""
        return self.shape[0] - 1 - int(y // CELL_SIZE), int(x // CELL_SIZE)

    def cells_of(
        self, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """The cells of many positions, ``[E]`` each: row and column, ``[E, 2]``."""
        rows = self.shape[0] - 1 - np.floor_divide(y, CELL_SIZE)
        return np.stack([rows, np.floor_divide(x, CELL_SIZE)], -1).astype(np.int64)


def load_layout_file(path: str | Path) -> Layout:
    """Read a layout from a text file; its stem becomes the name.

    Raises:
        LayoutError: if the file is missing, not text, or breaks a layout rule.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise LayoutError(
            "the file must exist, and no such file was found", name=str(path)
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise LayoutError(
            f"the file must be readable UTF-8 text, got {error}", name=str(path)
        ) from None
    return Layout(text, name=path.stem)
