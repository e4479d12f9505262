"""Which moves between waypoints become edges."""

import numpy as np
from hypothesis import given, strategies as st
from scipy.sparse.csgraph import connected_components

from toponav.graph.poses import MoveRules, drop_hanging, drop_unjoined, trusted_moves


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


def test_a_waypoint_that_hangs_on_one_rare_move_goes() -> None:
    # A corridor of five waypoints 3 steps apart, the last of which was entered once and
    # left once: no other is within 2.5 steps of it. 5 was entered from 1 and lies a
    # step beside it; 6 is 5 steps off, 7 and 8 are joined to each other alone.
    positions = np.array([[3.0 * x, 0.0] for x in range(5)] + [[3.0, 1.0], [3.0, 5.0]])
    positions = np.concatenate([positions, [[6.0, 1.0], [6.0, 2.0]]])
    moves = {(0, 1): 3, (1, 2): 3, (2, 3): 3, (3, 4): 1, (4, 3): 1}
    moves |= {(1, 5): 1, (5, 1): 1, (1, 6): 1, (7, 8): 1}
    kept = drop_hanging(moves, positions, MoveRules(beside=2.5))
    assert moves.keys() - kept.keys() == {(1, 5), (5, 1)}
    assert all(moves[pair] == count for pair, count in kept.items())
    # By 3 steps, 3 stands for 4. 0 was entered three times and stays.
    kept = drop_hanging(moves, positions, MoveRules(beside=3.0))
    assert moves.keys() - kept.keys() == {(1, 5), (5, 1), (3, 4), (4, 3)}
    # Entered twice and left once it stays.
    kept = drop_hanging(moves | {(1, 5): 2}, positions, MoveRules(beside=2.5))
    assert kept == moves | {(1, 5): 2}


def test_a_hub_of_waypoints_that_hang_keeps_them() -> None:
    # All lie within a step of 0, but it has no other moves.
    positions = np.array([[0.0, 0], [1, 0], [0, 1], [-1, 0], [0.5, 0.5], [0.5, 0.2]])
    hub = {(0, 1): 1, (0, 2): 1, (3, 0): 1}
    assert drop_hanging(hub, positions, MoveRules()) == hub
    # Nor with others around that are well joined.
    around = hub | {(4, 5): 9}
    assert drop_hanging(around, positions, MoveRules()) == around


pairs_of_ends = st.tuples(st.integers(0, 7), st.integers(0, 7))


@given(st.dictionaries(pairs_of_ends, st.integers(1, 3), max_size=20))
def test_the_rest_stays_joined_as_it_was(found) -> None:
    moves = {pair: count for pair, count in found.items() if pair[0] != pair[1]}
    positions = np.array([[at % 3, at // 3] for at in range(8)], float)
    kept = drop_hanging(moves, positions, MoveRules())
    parts = [parts_of(moves), parts_of(kept)]
    ends = [{end for pair in some for end in pair} for some in (moves, kept)]
    for one in ends[1]:
        for other in ends[1]:
            together = [own[one] == own[other] for own in parts]
            assert together[0] == together[1]
    # No part is lost, and what went had one neighbour.
    assert {parts[0][end] for end in ends[0]} == {parts[0][end] for end in ends[1]}
    for end in ends[0] - ends[1]:
        assert len({pair for pair in map(frozenset, moves) if end in pair}) == 1


def parts_of(moves):
    graph = np.zeros((8, 8))
    for pair in moves:
        graph[pair] = 1
    return connected_components(graph, directed=False)[1].tolist()
