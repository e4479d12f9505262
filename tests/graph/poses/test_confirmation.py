"""`confirm_closures`: aliases go, what was walked twice stays."""

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from tests.graph.poses.ring_world import EFFECTS, compare, walk
from toponav.graph.poses import PoseRules, estimate_poses, pose_graph
from toponav.graph.poses.closures import Closures
from toponav.graph.poses.confirmation import ConfirmRules, confirm_closures

ONCE = ConfirmRules(passes=1)
LENGTH = 10


def two_walks(turned: float = 0.0):
    """The same ten views to the east twice, by frames that are turned to each other."""
    east = np.arange(LENGTH) * 1.0
    angle = np.deg2rad(turned)
    other = np.stack([east * np.cos(angle), east * np.sin(angle)], 1)
    positions = np.concatenate([np.stack([east, 0 * east], 1), other])
    headings = np.repeat([0.0, turned], LENGTH)
    return np.repeat([0, 1], LENGTH), headings, positions


def pairs(*given: tuple[int, int]) -> Closures:
    """View ``i`` of the first walk with view ``j`` of the second."""
    one, other = np.array(given, np.int64).reshape(-1, 2).T
    return Closures(one, other + LENGTH)


def confirmed(closures: Closures, rules: ConfirmRules, turned: float = 0.0):
    found = confirm_closures(closures, *two_walks(turned), rules)
    return list(zip(found.one.tolist(), (found.other - LENGTH).tolist(), strict=True))


def test_pairs_along_a_way_confirm_each_other_and_an_alias_goes() -> None:
    # (0, 9) says that the second walk's view 9 is where the first began: seen from the
    # others, 9 steps off, where 2 + 0.3 x 9 = 4.7 are allowed at most.
    found = confirmed(pairs((0, 0), (4, 4), (8, 8), (0, 9)), ONCE)
    assert found == [(0, 0), (4, 4), (8, 8)]


def test_pairs_of_one_moment_confirm_nothing() -> None:
    # At most two steps apart, where three are asked.
    assert confirmed(pairs((0, 0), (1, 1), (2, 2)), ONCE) == []
    assert len(confirmed(pairs((0, 0), (3, 3), (6, 6)), ONCE)) == 3


def test_pairs_beyond_the_window_confirm_nothing() -> None:
    rules = ConfirmRules(window=3, times=1, passes=1)
    assert confirmed(pairs((0, 0), (4, 4), (8, 8)), rules) == []
    assert len(confirmed(pairs((0, 0), (3, 3)), rules)) == 2


def test_a_walk_that_was_held_up_confirms_less_the_longer_the_way() -> None:
    # The second walk's ways are two thirds as long: over 9 steps it is 3 short, where
    # 2 + 0.3 x 9 = 4.7 are allowed, and at a third as long 6.
    walk_of, headings, positions = two_walks()
    rules = ConfirmRules(times=1, passes=1)
    for share, confirms in ((2 / 3, 2), (1 / 3, 0)):
        held = np.concatenate([positions[:LENGTH], share * positions[LENGTH:]])
        found = confirm_closures(pairs((0, 0), (9, 9)), walk_of, headings, held, rules)
        assert len(found) == confirms


def test_pairs_that_disagree_on_the_turn_confirm_nothing() -> None:
    walk_of, headings, positions = two_walks()
    headings[LENGTH + 4 :] = 31.0
    some = pairs((0, 0), (4, 4))
    rules = ConfirmRules(times=1, passes=1)
    assert not len(confirm_closures(some, walk_of, headings, positions, rules))
    headings[LENGTH + 4 :] = 29.0
    assert len(confirm_closures(some, walk_of, headings, positions, rules)) == 2


def test_a_second_pass_asks_those_alone_that_passed_the_first() -> None:
    # 0 and 3 confirm each other, as do 3 and 6, and 6 and 9: by a window of 3 the inner
    # ones have two that confirm them, the outer ones one. These two go, and with them
    # what the inner ones had.
    some, rules = pairs((0, 0), (3, 3), (6, 6), (9, 9)), {"window": 3, "times": 2}
    assert confirmed(some, ConfirmRules(**rules, passes=1)) == [(3, 3), (6, 6)]
    assert confirmed(some, ConfirmRules(**rules, passes=2)) == []


def test_without_passes_or_pairs_nothing_changes() -> None:
    assert confirmed(pairs((0, 9)), ConfirmRules(passes=0)) == [(0, 9)]
    assert confirmed(pairs(), ConfirmRules()) == []


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=12, unique=True),
    st.sampled_from([-90.0, 45.0, 180.0, 300.0]),
)
def test_how_a_walk_began_to_look_does_not_matter(given, turned) -> None:
    # No length or distance, all of them whole steps, lies just at a limit.
    rules = ConfirmRules(passes=1, least=2.9, apart=2.05)
    found = confirmed(pairs(*given), rules)
    assert found == confirmed(pairs(*given), rules, turned)
    assert set(found) <= set(given)


@pytest.fixture(scope="module")
def walks():
    made = [walk(env, 400, seed=env) for env in range(5)]
    return [one for one, _ in made], torch.cat([poses for _, poses in made])


def test_where_most_pairs_are_aliases_directions_are_found(walks, monkeypatch) -> None:
    find = pose_graph._closures

    def with_aliases(*given) -> Closures:
        true = find(*given)
        drawn = np.random.default_rng(0).integers(0, 2000, (2, 9 * len(true)))
        drawn.sort(axis=0)
        one = np.concatenate([true.one, drawn[0]])
        return Closures(one, np.concatenate([true.other, drawn[1]]))

    monkeypatch.setattr(pose_graph, "_closures", with_aliases)
    rules = {"above": 0.8, "every": 2, "rounds": 2, "updates": 50}

    def estimate(least_known: float):
        known = PoseRules(**rules, least_known=least_known)
        return estimate_poses(walks[0], EFFECTS, compare, torch.Tensor.float, known)

    assert estimate(0.0).known < 0.5
    found = estimate(0.8)
    assert found.known == 1
    turned = found.heading - walks[1][:, 2]
    assert ((turned - turned[0] + 180) % 360 - 180).abs().max() < 15
