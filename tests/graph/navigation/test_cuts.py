import torch
from hypothesis import given, strategies as st

from toponav.graph.navigation.goals import GoalNodes
from toponav.graph.navigation.planner import Planner
from toponav.graph.navigation.plans import Plans

ONE = torch.tensor([True, False])


def make_plans(num_agents, num_edges, **arguments):
    """Agents on a line."""
    line = torch.arange(num_edges).unsqueeze(1) + torch.tensor([0, 1])
    planner = Planner(num_edges + 1, line, torch.ones(num_edges))
    goals = GoalNodes(num_agents, 1, 1, patience=None)
    return Plans(planner, goals, **arguments)


def edges(*numbers):
    return torch.tensor(numbers)


def test_cuts_are_each_agents_own():
    plans = make_plans(2, 3)
    plans.cut(1, edges(0, 2))
    assert plans.closed.tolist() == [[False] * 3, [True, False, True]]
    assert plans.num_cuts.tolist() == [0, 1]


def test_the_newest_cut_opens_first_and_the_others_keep_what_they_closed():
    plans = make_plans(1, 4)
    plans.cut(0, edges(1, 2))
    plans.cut(0, edges(0, 1))
    assert plans.reopen_first(0)
    assert plans.closed[0].tolist() == [False, True, True, False]
    assert plans.reopen_first(0)
    assert not plans.closed.any()
    assert not plans.reopen_first(0)


def test_nothing_to_close_is_no_cut():
    plans = make_plans(1, 2)
    plans.cut(0, edges())
    assert plans.num_cuts.tolist() == [0]


def test_cuts_fade_after_so_many_decisions():
    plans = make_plans(2, 2, fade_after=3)
    plans.cut(0, edges(1))
    changed = [plans.pass_decision().tolist() for _ in range(4)]
    # Made at decision 0, open at decision 3.
    assert changed == [[False] * 2, [False] * 2, [True, False], [False] * 2]
    assert not plans.closed.any()


def test_what_fails_again_stays_closed_for_longer():
    plans = make_plans(1, 3, fade_after=3, fade_growth=2.0)
    lasted = []
    for _ in range(3):
        plans.cut(0, edges(0, 1))
        plans.cut(0, edges(1))  # closed already: it has not failed again
        decisions = 0
        while plans.closed[0, 0]:
            plans.pass_decision()
            decisions += 1
        lasted.append(decisions)
    # 3, 3 x 2 and 3 x 2 x 2 decisions.
    assert lasted == [3, 6, 12]
    plans.open_all(ONE[:1])
    plans.cut(0, edges(0))
    assert [plans.pass_decision().item() for _ in range(3)] == [False, False, True]


def test_without_a_path_what_failed_least_often_opens_first():
    plans = make_plans(1, 2, fade_after=1)
    plans.cut(0, edges(0))
    plans.pass_decision()
    plans.cut(0, edges(1))
    plans.cut(0, edges(0))  # again, and the newest
    assert plans.reopen_first(0)
    assert plans.closed[0].tolist() == [True, False]


def test_clearing_takes_some_agents_alone():
    plans = make_plans(2, 2)
    for agent in (0, 1):
        plans.cut(agent, edges(0))
    plans.open_all(ONE)
    assert plans.num_cuts.tolist() == [0, 1]
    assert plans.closed[:, 0].tolist() == [False, True]


@given(st.lists(st.lists(st.integers(0, 5), min_size=1, unique=True), max_size=5))
def test_opening_all_cuts_opens_all_edges(cuts):
    plans = make_plans(1, 6)
    for cut in cuts:
        plans.cut(0, torch.tensor(cut))
    assert plans.closed[0].sum() == len({edge for cut in cuts for edge in cut})
    while plans.reopen_first(0):
        left = plans.num_cuts.item()
        still = {edge for cut in cuts[:left] for edge in cut}
        assert set(plans.closed[0].nonzero().flatten().tolist()) == still
