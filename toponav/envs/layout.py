"""Text layouts of mazes: parse, check, measure.

A layout is a rectangle of characters: ``*`` is wall, a space is floor and a lower-case
letter is a *slot*, a floor cell that an episode can close. The first line is the north
side. In map units x points east and y north from the text's south-west corner; the
length of a cell's side there is the engine's.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from string import ascii_lowercase

import networkx as nx
import numpy as np
from numpy.typing import NDArray

Cell = tuple[int, int]

#: Longest side of a layout in cells: such a maze still loads in about two seconds.
MAX_SIDE = 101
# Characters of a file that may be read: several times those of the largest layout.
_LONGEST = 100_000

WALL = "*"
FLOOR = " "


class LayoutError(ValueError):
    """A layout text breaks a rule; the message names line and column (from 1)."""

    def __init__(
        self, rule: str, name: str, line: int | None = None, column: int | None = None
    ) -> None:
        place = f"layout {name!r}"
        for what, number in (("line", line), ("column", column)):
            place += "" if number is None else f", {what} {number}"
        super().__init__(f"{place}: {rule}")
        self.line = line
        self.column = column


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
        for rule, line, column in _broken_rules(self.rows):
            raise LayoutError(rule, self.name, line, column)

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
        return {key: letters[key] for key in sorted(letters) if key.isalpha()}

    def graph(self) -> "nx.Graph[Cell]":
        """The open cells and their four-neighbour steps."""
        return nx.grid_2d_graph(*self.shape).subgraph(self.cells).copy()

    def check_slots(self, letters: Iterable[str]) -> tuple[str, ...]:
        """The slot letters, sorted, each once; a ValueError if they cannot close."""
        wanted = tuple(sorted(set(letters)))
        if unknown := [letter for letter in wanted if letter not in self.slots]:
            have = ", ".join(self.slots) or "none"
            raise ValueError(
                f"blocked slots must be slots of {self.name} ({have}), "
                f"got '{unknown[0]}'"
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


def load_layout_file(path: str | Path) -> Layout:
    """Read a layout from a text file, named by its stem; raises ``LayoutError``."""
    path = Path(path)
    try:
        # A pipe or a device may have no end.
        if path.exists() and not path.is_file():
            raise OSError("a folder, pipe or device")
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(_LONGEST + 1)
        if len(text) > _LONGEST:
            raise OSError(f"more than {_LONGEST} characters")
    except FileNotFoundError:
        reason = "the file must exist, and no such file was found"
    except (OSError, ValueError) as error:
        reason = f"the file must be readable UTF-8 text, got {error}"
    else:
        return Layout(text, name=path.stem)
    raise LayoutError(reason, str(path))


# Letters by line and column, from 1; broken rules, each with its line and column.
_Letters = Mapping[tuple[int, int], str]
_Broken = Iterator[tuple[str, int | None, int | None]]


def _broken_rules(rows: tuple[str, ...]) -> _Broken:
    # Each check relies on those before it.
    yield from _check_shape(rows)
    places = product(range(1, len(rows) + 1), range(1, len(rows[0]) + 1))
    letters = dict(zip(places, "".join(rows), strict=True))
    yield from _check_letters(letters)
    yield from _check_border(letters)
    yield from _check_connected(letters)


def _check_shape(rows: tuple[str, ...]) -> _Broken:
    width = len(rows[0])
    if width == 0:
        yield "the first line must not be empty", 1, None
    for line, row in enumerate(rows, 1):
        if len(row) != width:
            rule = f"all lines must be as long as the first ({width} characters), "
            yield rule + f"got {len(row)}", line, min(len(row), width) + 1
    for what, side in (("lines", len(rows)), ("characters in a line", width)):
        if not 3 <= side <= MAX_SIDE:
            rule = f"the number of {what} must be between 3 and {MAX_SIDE}, got {side}"
            yield rule, 1, None


def _check_letters(letters: _Letters) -> _Broken:
    seen: dict[str, str] = {}
    for (line, column), letter in letters.items():
        if letter in (WALL, FLOOR):
            continue
        if letter not in ascii_lowercase:
            rule = "cells must be '*' (wall), ' ' (floor) or a to z (slot), "
            yield rule + f"got {letter!r}", line, column
        if letter in seen:
            rule = f"a slot letter must appear once, got '{letter}' here and at "
            yield rule + seen[letter], line, column
        seen[letter] = f"line {line}, column {column}"


def _check_border(letters: _Letters) -> _Broken:
    height, width = max(letters)
    for (line, column), letter in letters.items():
        if letter != WALL and (line in (1, height) or column in (1, width)):
            yield f"the border must be wall all around, got {letter!r}", line, column


def _check_connected(letters: _Letters) -> _Broken:
    cells = [cell for cell, letter in letters.items() if letter != WALL]
    if FLOOR not in letters.values():
        yield "there must be at least one floor cell, got none", None, None
    height, width = max(letters)
    graph = nx.grid_2d_graph(height + 1, width + 1).subgraph(cells).copy()
    first = cells[0]
    reached = nx.node_connected_component(graph, first)
    for cell in cells:
        if cell not in reached:
            rule = "every open cell must be reachable, got one that is cut off from "
            yield rule + f"line {first[0]}, column {first[1]}", *cell
    # Only a slot at a cut point of the graph divides the maze when it closes.
    for cell in sorted(nx.articulation_points(graph)):
        if letters[cell] != FLOOR:
            rule = "a closed slot must leave the maze in one piece, slot "
            yield rule + f"'{letters[cell]}' cuts it in two", *cell
