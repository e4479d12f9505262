"""`sparsify`: waypoints that stand for one place become one."""

import pytest
import torch

from tests.graph.grey_world import episode, make_map
from toponav.graph import sparsify


def dense(*greys):
    """A map of which every view is a waypoint, judged by looser thresholds after."""
    topological_map = make_map(tc_threshold=0.995, tc_reach=0.75)
    topological_map.add_episode(episode(*greys, views=True, env=0))
    topological_map.set_thresholds(0.9, 0.75)
    return topological_map


def test_neighbours_that_agree_about_their_neighbours_become_one() -> None:
    # 0 and 4 are 0.96 alike, and both see 20 (0.8 and 0.84): they differ by 0.04.
    topological_map = dense(0, 4, 20)
    assert topological_map.edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert sparsify(topological_map, tolerance=0.05).tolist() == [0, 0, 1]
    assert topological_map.edges.tolist() == [[0, 1]]
    assert topological_map.embeddings.flatten().tolist() == pytest.approx([0.0, 0.2])
    assert topological_map.waypoints.images[:, 0, 0, 0].tolist() == [0, 20]
    assert topological_map.waypoints.origins.tolist() == [[0, 0], [0, 2]]
    # What walked on from 4 to 20 now counts for 0: it was not walked before.
    assert topological_map.graph.traversals.tolist() == [[1, 0]]


def test_those_that_disagree_stay() -> None:
    topological_map = dense(0, 4, 20)
    assert sparsify(topological_map, tolerance=0.03).tolist() == [0, 1, 2]
    assert topological_map.num_waypoints == 3


def test_no_chain_of_small_steps_makes_a_large_one() -> None:
    # Each is 0.92 like the next. 5 becomes part of 4, 3 of 2 and 1 of 0, and no more.
    topological_map = dense(0, 8, 16, 24, 32, 40)
    assert sparsify(topological_map, tolerance=0.09).tolist() == [0, 0, 1, 1, 2, 2]
    away = topological_map.embeddings.flatten().diff()
    assert away.tolist() == pytest.approx([0.16, 0.16])


def test_waypoints_that_are_no_neighbours_stay() -> None:
    topological_map = make_map(tc_threshold=0.995, tc_reach=0.75, edges="time")
    topological_map.add_episode(episode(0))
    topological_map.add_episode(episode(4))
    topological_map.set_thresholds(0.9, 0.75)
    assert sparsify(topological_map).tolist() == [0, 1]


def test_an_episode_goes_on_where_it_was() -> None:
    topological_map = dense(50, 0, 4)
    topological_map.extend(episode(50, 4, 80, views=True, env=1)[:2].unsqueeze(0))
    topological_map.set_thresholds(0.9, 0.75)
    assert sparsify(topological_map, tolerance=0.05).tolist() == [0, 1, 1]
    topological_map.extend(episode(80, views=True, env=1).unsqueeze(0))
    assert topological_map.edges.tolist() == [[0, 1], [1, 2]]


def test_a_merge_must_end_at_a_waypoint_that_stays() -> None:
    with pytest.raises(ValueError, match="part of one that stays, got 0 in one that g"):
        dense(0, 4, 20).merge(torch.tensor([1, 2, 2]))


def test_the_tolerance_is_checked() -> None:
    with pytest.raises(ValueError, match=r"tolerance must be in \[0, 1\], got 2"):
        sparsify(dense(0), tolerance=2)
