"""The mazes that come with the package, and random ones."""

from collections.abc import Iterable
from difflib import get_close_matches
from importlib.resources import files

import networkx as nx
import numpy as np

from toponav.envs.layout import FLOOR, MAX_SIDE, WALL, Layout

#: Mazes 1 to 3 (paper: Fig. 15) and the parameter-selection maze (Fig. 13).
MAZES = ("maze1", "maze2", "maze3", "select")


def load_maze(name: str) -> Layout:
    """One of the package's mazes by name.

    ``maze1`` has three paths of different lengths between two boxes and the slots ``a``
    and ``b``; ``maze2`` a central corridor with six arms; ``maze3`` four loops and many
    dead ends; ``select`` is the maze for choosing parameters.

    Examples:
        >>> load_maze("maze1").num_cells, load_maze("maze1").slots
        (51, {'a': (8, 4), 'b': (4, 4)})
    """
    if name not in MAZES:
        raise unknown_name("maze", name, MAZES)
    text = files("toponav.envs").joinpath(f"layouts/{name}.txt").read_text("utf-8")
    return Layout(text, name=name)


def make_random_layout(
    rows: int, cols: int, *, seed: int, loops: float = 0.1
) -> Layout:
    """A random maze: a minimum spanning tree under random weights, plus loops.

    ``rows`` and ``cols`` count junctions, two cells apart. ``loops`` is the share of
    the remaining walls between junctions to open, in [0, 1].

    Examples:
        >>> print(make_random_layout(2, 3, seed=1).text)
        *******
        *     *
        ***** *
        *     *
        *******
    """
    most = (MAX_SIDE - 1) // 2
    for what, number in (("rows", rows), ("cols", cols)):
        if not 1 <= number <= most:
            raise ValueError(f"{what} must be between 1 and {most}, got {number}")
    if not 0.0 <= loops <= 1.0:
        raise ValueError(f"loops must lie in [0, 1], got {loops}")
    generator = np.random.default_rng(seed)
    grid = nx.grid_2d_graph(rows, cols)
    edges = sorted(grid.edges)
    for edge, weight in zip(edges, generator.random(len(edges)), strict=True):
        grid.edges[edge]["weight"] = float(weight)
    tree = nx.minimum_spanning_tree(grid)
    walls = [edge for edge in edges if not tree.has_edge(*edge)]
    opened = generator.permutation(len(walls))[: round(loops * len(walls))]
    letters = np.full((2 * rows + 1, 2 * cols + 1), WALL)
    letters[1::2, 1::2] = FLOOR
    for (r0, c0), (r1, c1) in [*tree.edges, *(walls[i] for i in opened)]:
        letters[r0 + r1 + 1, c0 + c1 + 1] = FLOOR
    text = "\n".join("".join(row) for row in letters)
    return Layout(text, name=f"random-{rows}x{cols}-{seed}")


def unknown_name(what: str, name: str, choices: Iterable[str]) -> ValueError:
    """The error for a name that is not among the choices; it names the nearest one."""
    known = sorted(choices)
    near = get_close_matches(name, known, n=1, cutoff=0.0)[0]
    return ValueError(
        f"{what} must be one of {', '.join(known)}, got '{name}' "
        f"(did you mean '{near}'?)"
    )
