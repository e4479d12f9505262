"""Text layouts of mazes: parse, validate, measure.

A layout is a rectangle of characters: ``*`` is wall, a space is floor and a lower-case
letter is a *slot*, a floor cell that an episode can close. The first line is the north
side. In map units x points east and y north from the text's south-west corner; how long
a cell's side is there is up to the engine, so whoever asks for them says it.
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


@dataclass(frozen=True)
class Layout:
    r"""A valid maze: immutable, hashable, with its geometry computed on demand.

    Args:
        text: the rows of the layout joined by newlines.
        name: what messages and plots call it.

    Raises:
        LayoutError: if the text is no closed, connected rectangle of known letters.

    Examples:
        >>> layout = Layout("*****\n*   *\n* *a*\n*   *\n*****", name="ring")
        >>> layout.num_cells, layout.slots
        (8, {'a': (2, 3)})
        >>> layout.centre((3, 1), cell_size=10)
        (15.0, 15.0)
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
        letters = {self.rows[row][column]: (row, column) for row, column in self.cells}
        return {
            letter: letters[letter] for letter in ascii_lowercase if letter in letters
        }

    def graph(self) -> "nx.Graph[Cell]":
        """The open cells and their four-neighbour steps."""
        return cell_graph(self.cells)

    def check_slots(self, letters: Iterable[str]) -> tuple[str, ...]:
        """The slot letters, sorted and without repeats, if they can all be closed.

        Raises:
            ValueError: if one is no slot here, or if together they cut the maze in two.
        """
        wanted = tuple(sorted(set(letters)))
        for letter in wanted:
            if letter not in self.slots:
                have = ", ".join(self.slots) or "none"
                raise ValueError(
                    f"blocked slots must be slots of {self.name} ({have}), "
                    f"got '{letter}'"
                )
        graph = self.graph()
        graph.remove_nodes_from([self.slots[letter] for letter in wanted])
        if not graph or not nx.is_connected(graph):
            raise ValueError(
                f"closed slots must leave {self.name} in one piece, "
                f"got {', '.join(wanted)} together"
            )
        return wanted

    def centre(self, cell: Cell, cell_size: float) -> tuple[float, float]:
        """Map position (x, y) of a cell's centre."""
        row, column = cell
        return (column + 0.5) * cell_size, (self.shape[0] - row - 0.5) * cell_size

    def cell_of(self, x: float, y: float, cell_size: float) -> Cell:
        """The cell (row, column) in which a map position lies."""
        return self.shape[0] - 1 - int(y // cell_size), int(x // cell_size)

    def cells_of(
        self, x: NDArray[np.float64], y: NDArray[np.float64], cell_size: float
    ) -> NDArray[np.int64]:
        """The cells of many positions, ``[E]`` each: row and column, ``[E, 2]``."""
        rows = self.shape[0] - 1 - np.floor_divide(y, cell_size)
        return np.stack([rows, np.floor_divide(x, cell_size)], -1).astype(np.int64)


def load_layout_file(path: str | Path) -> Layout:
    """Read a layout from a text file; its stem becomes the name.

    Every problem with the file is a ``LayoutError``.
    """
    path = Path(path)
    try:
        return Layout(path.read_text(encoding="utf-8-sig"), name=path.stem)
    except FileNotFoundError:
        reason = "the file must exist, and no such file was found"
    except (OSError, UnicodeDecodeError) as error:
        reason = f"the file must be readable UTF-8 text, got {error}"
    raise LayoutError(reason, name=str(path))
