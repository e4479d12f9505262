"""Few waypoints for all views, and what joins them."""

import numpy as np
from hypothesis import given, strategies as st
from scipy.sparse.csgraph import connected_components

from toponav.graph.poses import (
    MoveRules,
    choose_waypoints,
    decisions_apart,
    drop_unjoined,
    nearest_waypoints,
    trusted_moves,
)

LIMITS = {"within": 4.0, "above": 0.6, "turn": 20.0}


def same(one, other):
    return np.ones(len(one))


coordinate = st.floats(-20, 20)


@given(
    st.lists(
        st.tuples(coordinate, coordinate, st.floats(0, 360)), min_size=1, max_size=30
    )
)
def test_each_view_has_a_waypoint_nearby_and_waypoints_are_apart(rows) -> None:
    poses = np.array(rows)
    chosen = choose_waypoints(poses, same, **LIMITS)
    apart = decisions_apart(poses[:, None], poses[chosen], 20.0)
    assert (apart.min(1) <= 4.0).all()
    between = decisions_apart(poses[chosen][:, None], poses[chosen], 20.0)
    assert (between[~np.eye(len(chosen), dtype=bool)] > 4.0).all()
    near = nearest_waypoints(poses, poses[chosen], same, **LIMITS)
    assert (near == apart.argmin(1)).all()


def test_a_wall_between_two_places_keeps_them_apart() -> None:
    # Two places three steps apart, from which different things are seen; the last view
    # is nearer to the second, and sees what is seen from the first.
    poses = np.array([[0.0, 0, 0], [3.0, 0, 0], [1.6, 0, 0]])
    side = np.array([0, 1, 0])

    def alike(one, other):
        return (side[one] == side[other]).astype(float)

    chosen = choose_waypoints(poses, alike, **LIMITS)
    assert chosen.tolist() == [0, 1]
    near = nearest_waypoints(
        poses, poses[chosen], lambda one, other: alike(one, chosen[other]), **LIMITS
    )
    assert near.tolist() == [0, 1, 0]


def test_views_without_a_waypoint_are_nowhere() -> None:
    views = np.array([[0.0, 0, 0], [4.1, 0, 0], [np.nan, 0, 0]])
    near = nearest_waypoints(views, np.zeros((1, 3)), same, **LIMITS)
    assert near.tolist() == [0, -1, -1]


def test_a_move_through_a_wall_that_was_made_once_goes() -> None:
    # Two corridors of 10 waypoints side by side, 2 steps from each other, joined at
    # their first ones.
    positions = np.array([[x, y] for y in (0.0, 2.0) for x in np.arange(10.0)])
    moves = {(at, at + 1): 4 for at in range(19) if at != 9} | {(0, 10): 4}
    once = {(4, 6): 1, (6, 4): 0, (9, 19): 1, (1, 11): 1}
    # By 1.5 x 2 + 3 = 6 steps at most: from 4 to 6 there are 2, from 1 to 11 there are
    # 1 + 2 + 1 = 4, from 9 to 19 there are 20.
    kept = trusted_moves(moves | once, positions, MoveRules())
    assert {pair for pair in once if pair in kept} == {(4, 6), (6, 4), (1, 11)}
    # What leads to the second corridor alone stays.
    del moves[0, 10]
    kept = trusted_moves(moves | {(9, 19): 1}, positions, MoveRules())
    assert kept[9, 19] == 1


def test_a_long_move_that_was_made_once_and_skips_places_goes() -> None:
    # Waypoints a step apart in a corridor, of which nothing joins the last two to the
    # others. 8 steps are allowed.
    positions = np.array([[x, 0.0] for x in range(20)])
    moves = {(at, at + 1): 2 for at in range(19) if at != 17}
    kept = trusted_moves(moves | {(0, 8): 1, (0, 9): 1}, positions, MoveRules())
    assert (0, 8) in kept
    assert (0, 9) not in kept
    kept = trusted_moves(moves | {(0, 9): 2, (9, 18): 1}, positions, MoveRules())
    assert kept[0, 9] == 2
    assert kept[9, 18] == 1


def test_there_and_back_count_together() -> None:
    positions = np.array([[0.0, 0.0], [0.0, 1.0], [9.0, 0.0]])
    often, rules = {(0, 1): 5, (1, 2): 5}, MoveRules(detour=0.1, beyond=0.1)
    assert (2, 0) in trusted_moves(often | {(0, 2): 1, (2, 0): 1}, positions, rules)
    assert (2, 0) not in trusted_moves(often | {(2, 0): 1}, positions, rules)


@given(st.lists(st.tuples(st.integers(0, 11), st.integers(0, 11)), max_size=20))
def test_rare_moves_join_parts_as_a_tree_does(pairs) -> None:
    # Places so far from each other that no way between two is short: of moves made
    # once, those stay that join two parts, whatever order they are read in.
    moves = {(one, other): 1 for one, other in pairs if one < other}
    positions = np.array([[100.0 * 1.1**at, at % 3] for at in range(12)])
    graph = np.zeros((12, 12))
    for pair in moves:
        graph[pair] = 1
    parts, _ = connected_components(graph, directed=False)
    kept = trusted_moves(moves, positions, MoveRules(detour=0, beyond=0))
    assert len(kept) == 12 - parts
    left = np.zeros((12, 12))
    for pair in kept:
        left[pair] = 1
    assert connected_components(left, directed=False)[0] == parts


@given(st.dictionaries(st.tuples(st.integers(0, 9), st.integers(0, 9)), st.just(2)))
def test_waypoints_that_no_move_joins_go_and_the_moves_stay(moves) -> None:
    joined, found = drop_unjoined(moves, 10)
    assert {(joined[one], joined[other]): 2 for one, other in found} == moves
    ends = {end for pair in moves for end in pair}
    assert set(joined.tolist()) == (ends or set(range(10)))
