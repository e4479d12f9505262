"""The rules of a layout's text, and the error that says where one is broken."""

from collections.abc import Iterable
from string import ascii_lowercase

import networkx as nx

Cell = tuple[int, int]

#: Longest side of a layout in cells: engine coordinates end at 32768 map units,
#: and mazes of this size still load in about two seconds.
MAX_SIDE = 101

WALL = "*"
FLOOR = " "


class LayoutError(ValueError):
    """A layout text breaks a rule; the message names its line and column."""

    def __init__(
        self,
        rule: str,
        *,
        name: str,
        line: int | None = None,
        column: int | None = None,
    ) -> None:
        place = f"layout '{name}'"
        if line is not None:
            place += f", line {line}"
        if column is not None:
            place += f", column {column}"
        super().__init__(f"{place}: {rule}")
        self.line = line
        self.column = column


def cell_graph(cells: Iterable[Cell]) -> "nx.Graph[Cell]":
    """The cells as nodes, with an edge between any two that are neighbours."""
    graph: nx.Graph[Cell] = nx.Graph()
    graph.add_nodes_from(cells)
    graph.add_edges_from(
        (cell, other)
        for cell in graph.nodes
        for other in ((cell[0] + 1, cell[1]), (cell[0], cell[1] + 1))
        if other in graph
    )
    return graph


def check_rows(rows: tuple[str, ...], name: str) -> None:
    """Check that rows of text are a closed, connected maze of known letters.

    Raises:
        LayoutError: if they are not; the message names the line and column.
    """
    _check_shape(rows, name)
    _check_letters(rows, name)
    _check_border(rows, name)
    _check_connected(rows, name)


def _check_shape(rows: tuple[str, ...], name: str) -> None:
    width = len(rows[0])
    if width == 0:
        raise LayoutError("the first line must not be empty", name=name, line=1)
    for number, row in enumerate(rows, 1):
        if len(row) != width:
            raise LayoutError(
                f"all lines must be as long as the first ({width} characters), "
                f"got {len(row)}",
                name=name,
                line=number,
                column=min(len(row), width) + 1,
            )
    for what, side in (("lines", len(rows)), ("characters in a line", width)):
        if not 3 <= side <= MAX_SIDE:
            raise LayoutError(
                f"the number of {what} must be between 3 and {MAX_SIDE}, got {side}",
                name=name,
                line=1,
            )


def _check_letters(rows: tuple[str, ...], name: str) -> None:
    seen: dict[str, tuple[int, int]] = {}
    for number, row in enumerate(rows, 1):
        for column, letter in enumerate(row, 1):
            if letter in (WALL, FLOOR):
                continue
            if letter not in ascii_lowercase:
                raise LayoutError(
                    "cells must be '*' (wall), ' ' (floor) or a to z (slot), "
                    f"got {letter!r}",
                    name=name,
                    line=number,
                    column=column,
                )
            if letter in seen:
                raise LayoutError(
                    f"a slot letter must appear once, got '{letter}' here and at "
                    f"line {seen[letter][0]}, column {seen[letter][1]}",
                    name=name,
                    line=number,
                    column=column,
                )
            seen[letter] = (number, column)


def _check_border(rows: tuple[str, ...], name: str) -> None:
    height, width = len(rows), len(rows[0])
    for number, row in enumerate(rows, 1):
        for column, letter in enumerate(row, 1):
            if letter != WALL and (number in (1, height) or column in (1, width)):
                raise LayoutError(
                    f"the border must be wall all around, got {letter!r}",
                    name=name,
                    line=number,
                    column=column,
                )


def _check_connected(rows: tuple[str, ...], name: str) -> None:
    cells = [
        (r, c)
        for r, row in enumerate(rows)
        for c, letter in enumerate(row)
        if letter != WALL
    ]
    if not any(rows[r][c] == FLOOR for r, c in cells):
        raise LayoutError("there must be at least one floor cell, got none", name=name)
    graph = cell_graph(cells)
    reached = nx.node_connected_component(graph, cells[0])
    for r, c in cells:
        if (r, c) not in reached:
            raise LayoutError(
                "every open cell must be reachable, got one that is cut off from "
                f"line {cells[0][0] + 1}, column {cells[0][1] + 1}",
                name=name,
                line=r + 1,
                column=c + 1,
            )
    # Only a slot at a cut point of the graph divides the maze when it closes.
    cuts = set(nx.articulation_points(graph))
    for r, c in cells:
        if rows[r][c] != FLOOR and (r, c) in cuts:
            raise LayoutError(
                f"a closed slot must leave the maze in one piece, slot "
                f"'{rows[r][c]}' cuts it in two",
                name=name,
                line=r + 1,
                column=c + 1,
            )
