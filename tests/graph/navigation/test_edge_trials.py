"""What trials of edges add up to, and when an agent's walk is one."""

import pytest
import torch
from hypothesis import given, strategies as st

from toponav.graph import EdgeTrials
from toponav.graph.navigation.edge_trials import TrialWatch
from toponav.graph.navigation.goals import GoalNodes
from toponav.graph.navigation.planner import Planner
from toponav.graph.navigation.plans import Plans

# A path of five, the last edge named from its far end.
LINE = torch.tensor([[0, 1], [1, 2], [2, 3], [4, 3]])
GUESS = torch.tensor([1.0, 2.0, 3.0, 4.0])


def add(trials, *rows) -> None:
    """Rows of start, end, whether it passed, decisions."""
    start, end, passed, decisions = zip(*rows, strict=True)
    ends = torch.tensor([start, end]).T
    trials.add(ends, torch.tensor(passed), torch.tensor(decisions))


def test_what_an_edge_costs() -> None:
    trials = EdgeTrials(LINE)
    add(trials, (0, 1, True, 3), (0, 1, True, 5), (0, 1, False, 12), (3, 4, True, 6))
    assert trials.tried[0].tolist() == [3, 0]
    assert trials.success[0, 0] == pytest.approx(2 / 3)
    assert (trials.walked[0, 0], trials.lost[0, 0]) == (3 + 5, 12)
    costs = trials.costs(GUESS)
    # Three passes took 3 + 5 + 6 decisions for guesses of 1 + 1 + 4: 7 / 3 for one.
    there = (2 * 1 + 3 / 7 * (3 + 5 + 12)) / (2 + 2)
    assert costs[0].tolist() == pytest.approx([there, 1])  # and never tried
    # From 4 to 3, and back.
    assert costs[3].tolist() == pytest.approx([4, (2 * 4 + 3 / 7 * 6) / (2 + 1)])
    assert torch.equal(EdgeTrials(LINE).costs(GUESS), GUESS.unsqueeze(1).expand(4, 2))
    assert trials.confirmed.nonzero().tolist() == [[0, 0], [3, 1]]
    # Of 0, 1, 2 the second edge; of 4, 3 the only one: it was passed from 3 alone.
    assert trials.num_unconfirmed([0, 1, 2]) == trials.num_unconfirmed([4, 3]) == 1
    assert trials.num_unconfirmed([3, 4]) == trials.num_unconfirmed([2]) == 0


def test_a_guess_may_say_what_the_way_back_costs() -> None:
    trials = EdgeTrials(LINE)
    add(trials, (0, 1, True, 3), (3, 4, True, 9))
    costs = trials.costs(torch.stack([GUESS, 2 * GUESS], 1))
    # Both passes took 3 + 9 decisions for guesses of 1 and, back, of 2 x 4.
    there, back = (2 * 1 + 9 / 12 * 3) / 3, (2 * 8 + 9 / 12 * 9) / 3
    assert costs[0].tolist() == pytest.approx([there, 2])
    assert costs[3].tolist() == pytest.approx([4, back])


def test_edges_that_never_passed_are_mistakes_until_one_does() -> None:
    trials = EdgeTrials(LINE)
    add(trials, (1, 2, False, 9))
    assert not trials.mistaken.any()
    add(trials, (2, 1, False, 9))
    assert trials.mistaken.tolist() == [False, True, False, False]
    add(trials, *[(1, 2, False, 9)] * 30, (2, 1, True, 2))
    # One in 20 + 2 trials, as the last 20 there count.
    assert not trials.mistaken.any()
    # What was open and closes for good is one: 0.95 ** 60 / 40 passed.
    add(trials, *[(2, 1, False, 9)] * 80)
    assert trials.mistaken.tolist() == [False, True, False, False]


def test_a_mistake_is_left_out_where_nothing_hangs_on_it() -> None:
    trials = EdgeTrials(torch.tensor([[0, 1], [1, 2], [0, 2], [2, 3]]))
    add(trials, *[(1, 2, False, 9)] * 2, *[(3, 2, False, 9)] * 2)
    # From 1 to 2 another way leads by 0; 3 would be cut off.
    assert trials.mistaken.tolist() == [False, True, False, True]
    assert trials.kept(4).tolist() == [True, False, True, True]
    # Of several that hold a part together one stays; waypoint 4 has no edge at all.
    add(trials, *[(0, 1, False, 9)] * 2)
    assert trials.kept(5).sum() == 3


def test_the_last_trials_count() -> None:
    trials = EdgeTrials(LINE)
    add(trials, *[(0, 1, True, 2)] * 20)
    assert trials.walked[0, 0] == 40
    add(trials, (0, 1, False, 10))
    # 19 of 20 stay of what there was: 20 x 0.95 + 1 trials, 40 x 0.95 decisions.
    assert trials.tried[0, 0] == pytest.approx(20)
    assert trials.passed[0, 0] == pytest.approx(19)
    assert trials.walked[0, 0] == pytest.approx(38)
    assert trials.lost[0, 0] == 10


ROW = st.tuples(st.integers(0, 3), st.booleans(), st.booleans(), st.integers(1, 30))


@given(st.lists(ROW, max_size=90))
def test_counts_fit_together_and_are_kept(found) -> None:
    trials = EdgeTrials(LINE)
    for edge, is_back, passed, decisions in found:
        ends = LINE[edge].tolist()
        add(trials, (*(ends[::-1] if is_back else ends), passed, decisions))
    assert (trials.passed <= trials.tried).all()
    assert trials.tried.max() < 20.01
    assert (trials.costs(GUESS) > 0).all()
    again = EdgeTrials(LINE)
    again.load_state_dict(trials.state_dict())
    assert torch.equal(again.costs(GUESS), trials.costs(GUESS))
    assert torch.equal(again.mistaken, trials.mistaken)


def test_counts_of_other_edges_or_that_do_not_fit_are_refused() -> None:
    trials = EdgeTrials(LINE)
    state = trials.state_dict()
    with pytest.raises(ValueError, match="edges must be the map's own 3, got other 4"):
        EdgeTrials(LINE[:3]).load_state_dict(state)
    with pytest.raises(ValueError, match="as many as passed, or more, got 0 of 1"):
        trials.load_state_dict({**state, "passed": state["passed"] + 1})


@pytest.mark.parametrize("name", ["tried", "passed", "walked", "lost"])
@pytest.mark.parametrize("bad", [-1.0, float("nan"), float("inf")])
def test_counts_that_are_no_numbers_are_refused(name: str, bad: float) -> None:
    trials = EdgeTrials(LINE)
    state = {key: one + 1 for key, one in trials.state_dict().items()}
    state["edges"] = LINE
    trials.load_state_dict(state)
    state[name][1, 0] = bad
    rule = f"trials must be finite numbers of 0 or more, got {bad:g} in {name}"
    with pytest.raises(ValueError, match=rule):
        trials.load_state_dict(state)


def test_passes_that_took_no_time_are_refused() -> None:
    trials = EdgeTrials(LINE)
    add(trials, (0, 1, True, 3))
    state = trials.state_dict()
    # Else a decision would make nothing, and every cost would be infinite.
    state["walked"] = torch.zeros_like(state["walked"])
    with pytest.raises(ValueError, match="must have taken decisions, got 1 in none"):
        EdgeTrials(LINE).load_state_dict(state)


@pytest.fixture
def plans() -> Plans:
    """One agent, whose goal is the end of the path."""
    goals = GoalNodes(1, 1, 4, patience=None)
    goals.nodes[0], goals.counts[0] = 4, True
    plans = Plans(Planner(5, LINE, GUESS), goals)
    plans.plan([0])
    return plans


def follow(watch, plans, *places, gave_up=False) -> None:
    for place in places:
        watch.follow(torch.tensor([place]), plans, gave_up=torch.tensor([gave_up]))


def test_a_trial_passes_where_less_is_left(plans) -> None:
    trials = EdgeTrials(LINE)
    watch = TrialWatch(trials, GUESS, 1)
    follow(watch, plans, 0, 0, -1, 1)
    # Three decisions after the first one it is at 1, and on the trial of the next edge,
    assert (trials.passed.sum(), trials.walked[0, 0]) == (1, 3)
    # which it passes when it is seen beyond its end: 3 - 4 is next.
    follow(watch, plans, 3)
    assert trials.passed[:, 0].tolist() == [1, 1, 0, 0]
    follow(watch, plans, 4)
    # From 3 to 4 is back along the edge from 4 to 3. At the goal there is no trial.
    assert trials.passed[3].tolist() == [0, 1]
    follow(watch, plans, *[4] * 60)
    assert trials.tried.sum() == 3


def test_a_trial_that_takes_too_long_is_in_vain(plans) -> None:
    trials = EdgeTrials(LINE)
    watch = TrialWatch(trials, GUESS, 1)
    # From 1 to 2: longer than 2 x 2 + 8 decisions.
    follow(watch, plans, 1, *[0] * 12)
    assert trials.tried.sum() == 0
    follow(watch, plans, 0)
    assert (trials.tried[1, 0], trials.passed.sum(), trials.lost[1, 0]) == (1, 0, 13)


def test_an_edge_that_is_closed_was_tried_in_vain(plans) -> None:
    trials = EdgeTrials(LINE)
    watch = TrialWatch(trials, GUESS, 1)
    follow(watch, plans, 1, 1)
    plans.close_edge(0, 1)
    follow(watch, plans, 1, gave_up=True)
    assert (trials.tried[1, 0], trials.passed.sum(), trials.lost[1, 0]) == (1, 0, 2)


def test_whoever_gets_a_new_path_is_not_judged(plans) -> None:
    trials = EdgeTrials(LINE)
    watch = TrialWatch(trials, GUESS, 1)
    follow(watch, plans, 0)
    # From 0 less is left to another goal than from 1 to the last one.
    plans.goals.nodes[0] = 1
    plans.plan([0])
    follow(watch, plans, 0)
    plans.goals.nodes[0] = 4
    plans.plan([0])
    plans.close_edge(0, 1)  # another one than it is on
    follow(watch, plans, 1, gave_up=True)
    plans.open_all(torch.tensor([True]))
    plans.plan([0])
    follow(watch, plans, 1, gave_up=True)
    assert trials.tried.sum() == 0
    follow(watch, plans, 2)
    assert trials.passed[1, 0] == 1


def test_it_may_take_longer_where_the_way_back_costs_more(plans) -> None:
    trials = EdgeTrials(LINE)
    watch = TrialWatch(trials, torch.stack([GUESS, 3 * GUESS], 1), 1)
    # From 3 to 4, which is back: up to 2 x 12 + 8 decisions.
    follow(watch, plans, *[3] * 33)
    assert trials.tried.sum() == 0
    follow(watch, plans, 3)
    assert trials.lost[3].tolist() == [0, 33]
    # From 1 to 2, which is there: up to 2 x 2 + 8.
    watch = TrialWatch(trials, torch.stack([GUESS, 3 * GUESS], 1), 1)
    follow(watch, plans, *[1] * 14)
    assert trials.lost[1].tolist() == [13, 0]


@pytest.mark.parametrize("place", [0, 4])
def test_a_way_that_opens_passes_no_edge(place) -> None:
    # From 0 to 1 at once, or round a square; 4 hangs on 1.
    edges = torch.tensor([[0, 1], [0, 2], [2, 3], [1, 3], [1, 4]])
    guess = torch.tensor([2.0, 5.0, 5.0, 5.0, 2.0])
    goals = GoalNodes(1, 1, 4, patience=None)
    goals.nodes[0], goals.counts[0] = 1, True
    plans = Plans(Planner(5, edges, guess), goals, fade_after=1)
    plans.plan([0])
    trials = EdgeTrials(edges)
    watch = TrialWatch(trials, guess, 1)
    follow(watch, plans, 0)
    plans.close_all(0, 0, torch.tensor([0, 4]))
    follow(watch, plans, 0, gave_up=True)
    assert (trials.tried.sum(), trials.passed.sum()) == (1, 0)
    # The cut opens by itself, or where nothing else leads on from: less is left than
    # from 2, where the next trial was to end.
    if place == 0:
        plans.plan(plans.pass_decision().nonzero().flatten().tolist())
    plans.open_up(torch.tensor([place]))
    assert plans.cost(torch.tensor([place])) == 2
    follow(watch, plans, place)
    assert (trials.tried.sum(), trials.passed.sum()) == (1, 0)
