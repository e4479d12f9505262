"""Regions of a maze that look alike: each gets its own walls and floor."""

import networkx as nx
import numpy as np

from toponav.envs.layout import Layout
from toponav.envs.layout_rules import Cell

# About this many cells look alike; more would leave long corridors without marks.
_CELLS_PER_REGION = 9


def assign_regions(
    layout: Layout, generator: np.random.Generator
) -> tuple[dict[Cell, int], int]:
    r"""Split the open cells into connected regions of similar size.

    Random seed cells, kept apart by taking the farthest cell each time, collect
    the cells that are nearest to them by geodesic distance.

    Args:
        layout: the maze.
        generator: draws the first seed cell.

    Returns:
        Region index of every open cell, and the number of regions.

    Examples:
        >>> layout = Layout("*****\n*   *\n*****", name="lane")
        >>> assign_regions(layout, np.random.default_rng(0))
        ({(1, 1): 0, (1, 2): 0, (1, 3): 0}, 1)
    """
    graph = layout.graph()
    num_regions = max(1, round(layout.num_cells / _CELLS_PER_REGION))
    first = layout.cells[generator.integers(layout.num_cells)]
    nearest = dict.fromkeys(layout.cells, 0)
    distance = nx.single_source_shortest_path_length(graph, first)
    for region in range(1, num_regions):
        seed = max(layout.cells, key=distance.__getitem__)
        closer = nx.single_source_shortest_path_length(graph, seed)
        for cell, length in closer.items():
            if length < distance[cell]:
                nearest[cell], distance[cell] = region, length
    return nearest, num_regions
