"""Regions of a maze whose walls and floors look alike, for any engine to draw."""

import networkx as nx
import numpy as np

from toponav.envs.layout import Cell, Layout

# About this many cells look alike; more would leave long corridors without landmarks.
_CELLS_PER_REGION = 9


def assign_regions(
    layout: Layout, generator: np.random.Generator
) -> tuple[dict[Cell, int], int]:
    """Region of every open cell, and the number of regions, all of similar size.

    Random seed cells, kept apart by taking the farthest cell each time, collect the
    cells that are nearest to them by geodesic distance.
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
