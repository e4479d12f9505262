import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from toponav.graph.attempts import Attempts
from toponav.graph.blockages import Blockages

ONE = torch.tensor([True, False])


def edges(*numbers):
    return torch.tensor(numbers)


def test_cuts_are_each_agents_own():
    blockages = Blockages(2, 3)
    blockages.cut(1, edges(0, 2))
    assert blockages.closed.tolist() == [[False] * 3, [True, False, True]]
    assert blockages.num_cuts.tolist() == [0, 1]


def test_the_oldest_cut_opens_first_and_a_later_one_keeps_what_it_closed():
    blockages = Blockages(1, 4)
    blockages.cut(0, edges(0, 1))
    blockages.cut(0, edges(1, 2))
    assert blockages.reopen_oldest(0)
    assert blockages.closed[0].tolist() == [False, True, True, False]
    assert blockages.reopen_oldest(0)
    assert not blockages.closed.any()
    assert not blockages.reopen_oldest(0)


def test_nothing_to_close_is_no_cut():
    blockages = Blockages(1, 2)
    blockages.cut(0, edges())
    assert blockages.num_cuts.tolist() == [0]


def test_cuts_fade_after_so_many_decisions():
    blockages = Blockages(2, 2, fade_after=3)
    blockages.cut(0, edges(1))
    changed = [blockages.pass_decision().tolist() for _ in range(4)]
    # Made at decision 0, open at decision 3.
    assert changed == [[False] * 2, [False] * 2, [True, False], [False] * 2]
    assert not blockages.closed.any()


def test_clearing_takes_some_agents_alone():
    blockages = Blockages(2, 2)
    for agent in (0, 1):
        blockages.cut(agent, edges(0))
    blockages.clear(ONE)
    assert blockages.num_cuts.tolist() == [0, 1]
    assert blockages.closed[:, 0].tolist() == [False, True]


@given(st.lists(st.lists(st.integers(0, 5), min_size=1, unique=True), max_size=5))
def test_opening_all_cuts_opens_all_edges(cuts):
    blockages = Blockages(1, 6)
    for cut in cuts:
        blockages.cut(0, torch.tensor(cut))
    assert blockages.closed[0].sum() == len({edge for cut in cuts for edge in cut})
    while blockages.reopen_oldest(0):
        left = blockages.num_cuts.item()
        still = {edge for cut in cuts[len(cuts) - left :] for edge in cut}
        assert set(blockages.closed[0].nonzero().flatten().tolist()) == still


def count(attempts, place, onward, cost):
    return attempts.count(
        torch.tensor([place]), torch.tensor([onward]), torch.tensor([float(cost)])
    ).item()


@pytest.fixture
def attempts():
    made = Attempts(patience=3)
    made.resize(1)
    return made


def test_an_edge_is_stuck_after_so_many_decisions_without_getting_on(attempts):
    # The first decision gets on: nothing was known before.
    found = [count(attempts, 0, 1, 9) for _ in range(7)]
    assert found == [False, False, False, True, False, False, True]


def test_getting_on_begins_anew(attempts):
    for cost in (9, 9, 9, 8, 8, 8):
        assert not count(attempts, 0, 1, cost)
    assert count(attempts, 0, 1, 8)


def test_edges_are_counted_apart_and_not_forgotten_in_between(attempts):
    # Swaying between places 0 and 2 before a blockage: each is stuck in its turn.
    found = [count(attempts, place, 1, 9) for place in (0, 0, 2, 0, 2, 0, 2)]
    assert found == [False] * 5 + [True, True]


def test_an_edge_that_was_walked_is_counted_anew(attempts):
    # From 0 to 1 as wanted, and from 1, where it does not get on to 2, back to 0.
    steps = [(0, 1, 9), (1, 2, 8)] + [(0, 1, 9), (1, 2, 8)] * 3
    found = [count(attempts, *step) for step in steps]
    assert found == [False] * 7 + [True]


def test_driven_off_and_back_is_not_getting_on(attempts):
    count(attempts, 0, 1, 5)
    found = [count(attempts, *step) for step in ((7, 8, 9), (8, 0, 6), (0, 1, 5))]
    assert found == [False, False, False]
    assert [count(attempts, 0, 1, 5) for _ in range(2)] == [False, True]


def test_the_lost_and_those_at_the_goal_are_not_stuck(attempts):
    for place, onward, cost in ((-1, 0, torch.inf), (4, 4, 0)):
        assert not any(count(attempts, place, onward, cost) for _ in range(9))


def test_a_new_plan_measures_getting_on_anew(attempts):
    count(attempts, 0, 1, 5)
    attempts.replan(0, 9.0)
    assert not any(count(attempts, 0, 2, cost) for cost in (8, 7, 6, 5, 4))


def test_no_patience_never_gives_up():
    attempts = Attempts(patience=None)
    attempts.resize(1)
    assert not any(count(attempts, 0, 1, 5) for _ in range(99))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Attempts(patience=0), "patience must be at least 1, got 0"),
        (lambda: Blockages(1, 1, fade_after=0), "fade_after must be at least 1, got 0"),
    ],
)
def test_numbers_out_of_range_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_an_edge_tried_in_vain_so_many_times_is_stuck():
    attempts = Attempts(patience=100, tries=2)
    attempts.resize(1)
    # Around in a circle: from 0 the way leads to 1, but one comes to 2, no nearer, and
    # from there back to 0. The second time that 0 is left in vain, its edge is stuck
    # when it is to be tried a third time.
    lap = [(0, 1, 5), (2, 0, 6)]
    found = [count(attempts, *step) for step in lap * 2 + lap[:1]]
    assert found == [False] * 4 + [True]
    # Then all is forgotten.
    assert [count(attempts, *step) for step in lap * 2] == [False] * 4


def test_a_way_on_by_another_place_is_no_try_in_vain():
    attempts = Attempts(patience=100, tries=1)
    attempts.resize(1)
    # From 0 not to 1 but to 2, which is nearer to the goal all the same.
    found = [count(attempts, *step) for step in [(0, 1, 5), (2, 3, 4), (0, 1, 5)]]
    assert found == [False, False, False]


def test_tries_must_be_some():
    with pytest.raises(ValueError, match="tries must be at least 1, got 0"):
        Attempts(tries=0)
