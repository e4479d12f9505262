"""How far views of other walks agree with a view at its pose."""

import numpy as np
from hypothesis import given, strategies as st

from toponav.graph.poses import SupportRules, choose_waypoints, find_support

RULES = SupportRules(within=2.0, most=4, doubt=2.0)
HERE = np.zeros((1, 3))
FIRST = np.zeros(1, np.int64)


def same(one, other):
    return np.ones(len(one))


def support_of(views, walk_of, alike=same, rules=RULES, candidates=HERE):
    own = FIRST.repeat(len(candidates))
    given = np.array(views, float), np.array(walk_of)
    return find_support(candidates, own, *given, alike, turn=20.0, rules=rules)


def test_views_of_other_walks_nearby_are_asked() -> None:
    # Of other walks, a step to the north and turned by half a decision; of its own
    # walk; three steps away; two steps and half a decision; nowhere.
    views = [[0, 1, 0], [0, 0, 10], [0, 0, 0], [3, 0, 0], [2, 0, 10], [np.nan] * 3]
    asked = []

    def alike(one, other):
        asked.extend(one.tolist())
        assert (other == 0).all()
        return np.array([0.9, 0.3])[one]

    found = support_of(views, [1, 2, 0, 1, 2, 1], alike)
    assert sorted(asked) == [0, 1]
    np.testing.assert_allclose(found, 0.3)  # (0.9 + 0.3) / (2 + 2)


def test_few_views_say_little_and_many_are_drawn_from() -> None:
    one, none = support_of([[0, 1, 0]], [1]), support_of([[0, 1, 0]], [0])
    np.testing.assert_allclose(one, 1 / 3)  # 1 / (1 + 2)
    assert none == 0
    # Of nine views, all alike, four are asked: 4 / (4 + 2).
    views = np.zeros((9, 3))
    np.testing.assert_allclose(support_of(views, np.arange(1, 10)), 4 / 6)

    def drawn(seed):
        asked = []

        def alike(one, other):
            asked.extend(one.tolist())
            return same(one, other)

        rules = SupportRules(most=4, seed=seed)
        support_of(views, np.arange(1, 10), alike, rules)
        return asked

    assert drawn(0) == drawn(0) != drawn(1)


def test_candidates_are_asked_about_one_by_one() -> None:
    # The second has no pose; the third is like the view beside it to 0.6.
    candidates = np.array([[0.0, 0, 0], [np.nan] * 3, [9.0, 0, 0]])
    found = support_of(
        [[0, 1, 0], [9, 1, 0]],
        [1, 1],
        lambda one, other: np.where(other == 2, 0.6, 0.9),
        candidates=candidates,
    )
    np.testing.assert_allclose(found, [0.3, 0.0, 0.2])  # 0.9 / 3, 0, 0.6 / 3
    assert support_of(np.zeros((0, 3)), [], candidates=candidates).tolist() == [0] * 3
    assert len(support_of([[0, 1, 0]], [1], candidates=np.zeros((0, 3)))) == 0


@given(st.lists(st.floats(0, 1), max_size=12))
def test_one_more_view_that_agrees_supports_and_one_that_does_not_doubts(
    similar: list[float],
) -> None:
    def of(numbers):
        views = np.zeros((len(numbers), 3))
        values = np.array([*numbers, 0.0])
        rules = SupportRules(most=99)
        return support_of(
            views, np.ones(len(numbers), int), lambda one, _: values[one], rules
        )[0]

    found = of(similar)
    assert 0 <= found < 1
    assert of([*similar, 0.0]) <= found <= of([*similar, 1.0])


def test_the_best_supported_are_chosen_first_and_doubted_ones_where_none_is() -> None:
    limits = {"within": 4.0, "above": 0.6, "turn": 20.0}
    # Two at one spot, of which the second has more support; one beside them that looks
    # like nothing else, doubted; one far away, doubted.
    poses = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [20, 0, 0]])
    looks = np.array([0, 0, 1, 2])

    def alike(one, other):
        return (looks[one] == looks[other]).astype(float)

    support = np.array([0.5, 0.8, 0.3, 0.0])
    chosen = choose_waypoints(poses, alike, **limits, support=support, least=0.4)
    assert chosen.tolist() == [1, 3]
    # Without doubts the third stays too, and without support the first stands for both.
    chosen = choose_waypoints(poses, alike, **limits, support=support, least=0.0)
    assert chosen.tolist() == [1, 2, 3]
    assert choose_waypoints(poses, alike, **limits).tolist() == [0, 2, 3]


def test_of_those_with_much_the_same_support_the_first_is_chosen() -> None:
    limits = {"within": 4.0, "above": 0.6, "turn": 20.0}
    # At one spot; 0.3 / 0.1 is a little less than 3.
    support = np.array([0.2, 0.32, 0.3, 0.39])
    poses = np.zeros((4, 3))

    def chosen(rounding):
        given = {**limits, "support": support, "rounding": rounding}
        return choose_waypoints(poses, same, **given).tolist()

    assert chosen(0.0) == [3]
    assert chosen(0.1) == [1]  # 2, 3, 3 and 3 times 0.1
    assert chosen(0.5) == [0]  # none has 0.5
    support = np.array([0.32, 0.3])[::-1]
    poses = poses[:2]
    assert chosen(0.1) == [0]
