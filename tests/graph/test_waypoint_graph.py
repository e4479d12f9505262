"""`WaypointGraph`: edges, their evidence, and what is near."""

import math

import pytest
import torch

from toponav.graph import WaypointGraph


def line(length, **arguments):
    """Waypoints in a row, all walked."""
    graph = WaypointGraph(**arguments)
    for _ in range(length):
        graph.add_waypoint()
    for one in range(length - 1):
        graph.traverse(one, one + 1)
    return graph


def test_an_edge_costs_less_once_it_was_walked() -> None:
    graph = line(3, untraversed_edge_cost=4.0)
    graph.link(2, [0], [0.8])
    assert graph.edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    # Walked from 0 to 1 and from 1 to 2, and never back.
    assert graph.edge_cost.tolist() == [[1, 4], [4, 4], [1, 4]]
    graph.traverse(2, 0)
    assert graph.edge_cost.tolist() == [[1, 4], [4, 1], [1, 4]]
    assert graph.traversals.tolist() == [[1, 0], [0, 1], [1, 0]]
    assert graph.edge_similarity[1].item() == pytest.approx(0.8)


def test_the_version_goes_up_when_something_changes_and_only_then() -> None:
    graph = line(2)
    version = graph.version
    graph.traverse(0, 1)
    graph.traverse(1, 1)
    graph.link(0, [], [])
    assert graph.version == version
    assert graph.traversals.tolist() == [[2, 0]]
    back = lambda: graph.traverse(1, 0)  # noqa: E731
    for change in (back, graph.add_waypoint, lambda: graph.traverse(0, 2)):
        change()
        assert graph.version == version + 1
        version = graph.version


def test_a_waypoint_is_no_neighbour_of_itself() -> None:
    graph = line(2)
    graph.link(1, [1], [1.0])
    graph.traverse(1, 1)
    assert graph.edges.tolist() == [[0, 1]]


def test_what_is_near_is_counted_in_edges() -> None:
    graph = line(6)
    assert graph.neighbours(2) == [1, 3]
    assert graph.nearby(2, 1) == [2]
    assert graph.nearby(2, 3) == [1, 2, 3]
    assert graph.nearby(2, 99) == [0, 1, 2, 3, 4, 5]


def test_walked_neighbours_are_nearer_than_seen_ones() -> None:
    graph = line(2)
    graph.add_waypoint()
    graph.add_waypoint()
    graph.link(1, [2], [0.9])
    graph.traverse(1, 3)
    assert graph.nearby(1, 3) == [0, 1, 3]
    graph.traverse(1, 2)
    assert graph.nearby(1, 3) == [0, 1, 2]


def test_edges_that_nothing_speaks_for_are_dropped() -> None:
    graph = line(2)
    for _ in range(2):
        graph.add_waypoint()
    graph.link(3, [0, 1], [0.9, 0.9])
    # 0-1 was walked, 0-3 is above 0.7, 1-3 is not; NaN never is.
    assert graph.update_similarities(torch.tensor([0.1, 0.8, 0.7]), 0.7) == 1
    assert graph.edges.tolist() == [[0, 1], [0, 3]]
    assert graph.update_similarities(torch.tensor([math.nan, math.nan]), 0.7) == 1
    assert graph.edges.tolist() == [[0, 1]]


def test_merging_adds_traversals_up_and_keeps_the_best_similarity() -> None:
    graph = line(4)
    graph.link(3, [1], [0.6])
    graph.link(0, [1], [0.7])
    # 0 and 3 become one: 0-1 (once, 0.7) and 1-3 (never, 0.6) too, and 2-3 is 0-2.
    graph.merge(torch.tensor([0, 1, 2, 0]))
    assert graph.edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    # What was walked from 2 to 3 now leads from the higher to the lower.
    assert graph.traversals.tolist() == [[1, 0], [0, 1], [1, 0]]
    assert graph.edge_similarity[0].item() == pytest.approx(0.7)
    assert graph.edge_similarity[1:].isnan().all()
    # All in one: no edge is left.
    graph.merge(torch.zeros(3, dtype=torch.int64))
    assert graph.edges.shape == (0, 2)
    assert graph.add_waypoint() == 1


def test_edges_must_join_waypoints() -> None:
    graph = WaypointGraph()
    with pytest.raises(ValueError, match="must join waypoints 0 to 1, got 0 to 2"):
        graph.load_state_dict({"edges": torch.tensor([[0, 2]])}, 2)
