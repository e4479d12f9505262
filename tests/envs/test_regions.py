"""Parts of a maze that look alike."""

import networkx as nx
import numpy as np
from hypothesis import given, settings, strategies as st

from tests.envs.layouts import drawn_layouts, random_layouts
from toponav.envs import Layout, load_maze
from toponav.envs.regions import assign_regions


@settings(max_examples=60, deadline=None)
@given(layout=random_layouts() | drawn_layouts(), seed=st.integers(0, 99))
def test_regions_are_connected_and_none_is_empty(layout: Layout, seed: int) -> None:
    regions, number = assign_regions(layout, np.random.default_rng(seed))
    # One region for nine cells, at least one.
    assert number == max(1, round(layout.num_cells / 9))
    assert set(regions) == set(layout.cells)
    assert set(regions.values()) == set(range(number))
    for region in range(number):
        cells = [cell for cell in layout.cells if regions[cell] == region]
        assert nx.is_connected(layout.graph().subgraph(cells))


def test_regions_are_the_generators_function() -> None:
    layout = load_maze("maze3")
    drawn = [
        tuple(assign_regions(layout, np.random.default_rng(seed))[0].items())
        for seed in (0, 0, *range(1, 8))
    ]
    assert drawn[0] == drawn[1]
    assert len(set(drawn)) > 4
