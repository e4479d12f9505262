"""The rules of a layout's text, and the error that says where one is broken."""

from collections.abc import Iterable, Iterator
from string import ascii_lowercase

import networkx as nx

Cell = tuple[int, int]

#: Longest side of a layout in cells: engines' coordinates end, and mazes of this size
#: still load in about two seconds.
MAX_SIDE = 101

WALL = "*"
FLOOR = " "


class LayoutError(ValueError):
    """A layout text breaks a rule; the message names line and column (from 1)."""

    def __init__(
        self,
        rule: str,
        *,
        name: str,
        line: int | None = None,
        column: int | None = None,
    ) -> None:
        place = f"layout '{name}'"
        for what, number in (("line", line), ("column", column)):
            place += "" if number is None else f", {what} {number}"
        super().__init__(f"{place}: {rule}")
        self.line = line
        self.column = column


def cell_graph(cells: Iterable[Cell]) -> "nx.Graph[Cell]":
    """The cells as nodes, with an edge between any two that are neighbours."""
    graph: nx.Graph[Cell] = nx.Graph()
    graph.add_nodes_from(cells)
    for row, column in list(graph):
        for other in ((row + 1, column), (row, column + 1)):
            if other in graph:
                graph.add_edge((row, column), other)
    return graph


def check_rows(rows: tuple[str, ...], name: str) -> None:
    """Raise a ``LayoutError`` if rows of text are no closed, connected maze."""
    # Each check relies on those before it.
    for check in (_check_shape, _check_letters, _check_border, _check_connected):
        for rule, line, column in check(rows):
            raise LayoutError(rule, name=name, line=line, column=column)


# Broken rules, each with its line and column.
_Broken = Iterator[tuple[str, int | None, int | None]]


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


def _letters(rows: tuple[str, ...]) -> Iterator[tuple[int, int, str]]:
    """Line, column (from 1) and letter of every cell."""
    for line, row in enumerate(rows, 1):
        for column, letter in enumerate(row, 1):
            yield line, column, letter


def _check_letters(rows: tuple[str, ...]) -> _Broken:
    seen: dict[str, str] = {}
    for line, column, letter in _letters(rows):
        if letter in (WALL, FLOOR):
            continue
        if letter not in ascii_lowercase:
            rule = "cells must be '*' (wall), ' ' (floor) or a to z (slot), "
            yield rule + f"got {letter!r}", line, column
        if letter in seen:
            rule = f"a slot letter must appear once, got '{letter}' here and at "
            yield rule + seen[letter], line, column
        seen[letter] = f"line {line}, column {column}"


def _check_border(rows: tuple[str, ...]) -> _Broken:
    height, width = len(rows), len(rows[0])
    for line, column, letter in _letters(rows):
        if letter != WALL and (line in (1, height) or column in (1, width)):
            yield f"the border must be wall all around, got {letter!r}", line, column


def _check_connected(rows: tuple[str, ...]) -> _Broken:
    letters = {(r, c): letter for r, c, letter in _letters(rows) if letter != WALL}
    if FLOOR not in letters.values():
        yield "there must be at least one floor cell, got none", None, None
    graph = cell_graph(letters)
    first = next(iter(letters))
    reached = nx.node_connected_component(graph, first)
    for cell in letters:
        if cell not in reached:
            rule = "every open cell must be reachable, got one that is cut off from "
            yield rule + f"line {first[0]}, column {first[1]}", *cell
    # Only a slot at a cut point of the graph divides the maze when it closes.
    cuts = set(nx.articulation_points(graph))
    for cell, letter in letters.items():
        if letter != FLOOR and cell in cuts:
            rule = "a closed slot must leave the maze in one piece, slot "
            yield rule + f"'{letter}' cuts it in two", *cell
