"""An agent that walks to waypoints of its own choice in the ring, and says how."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from tests.graph.navigation.test_pose_navigator import (
    POSES,
    ROUND,
    edges,
    go,
    make,
    reading,
)
from toponav import keys
from toponav.graph import PractisingNavigator, SteeringSenses
from toponav.graph.navigation import Planner, practising_navigator
from toponav.modules import SteeringNetwork

START = (6.9, 2.5, 10.0)


def practising(controller=None, seed=0, map=None, confirm=0.0) -> PractisingNavigator:
    """The navigator of the ring, made to practise."""
    other = make(seed)
    size = other.map.embeddings.shape[1]
    actions = len(other.known.effects)
    network = SteeringNetwork(size, SteeringSenses.size(actions), actions)
    return PractisingNavigator(
        map=map or other.map,
        embed=other.embed,
        compare=other.compare,
        rules=other.rules,
        known=other.known,
        belief=other.belief_rules,
        controller=controller or network,
        confirm=confirm,
        seed=seed,
    )


def look(pose, *, begins) -> TensorDict:
    """What it reads: no goal, and no reward."""
    found = reading([pose], [(2.5, 9.1)], begins=begins)
    return found.select(keys.PIXELS, keys.IS_INIT)


def walk(navigator, decisions) -> list[TensorDict]:
    """What it wrote in each decision."""
    pose, found = START, []
    for number in range(decisions):
        data = navigator(look(pose, begins=number == 0))
        found.append(data)
        pose = go(pose, int(data[keys.ACTION]))
    return found


def test_it_reaches_its_targets_and_draws_others() -> None:
    navigator = practising()
    found = walk(navigator, 150)
    reached = [bool(data[keys.REACHED]) for data in found]
    # At most 22 steps round half of the ring and 18 turns: 40 decisions a target.
    assert sum(reached) >= 3
    ends = [int(data[keys.GOAL_NODE]) for data in found]
    numbers = [number for number, is_there in enumerate(reached) if is_there]
    # It has a new target and a path to it in the same decision; one in 80 is the last.
    assert sum(ends[n] != ends[n - 1] for n in numbers) >= len(numbers) - 1
    assert min(ends) >= 0


def test_progress_is_what_less_is_left() -> None:
    found = walk(practising(), 120)
    changes = [bool(data[keys.REACHED] | data[keys.GAVE_UP]) for data in found]
    first = changes.index(True)
    told = sum(float(data[keys.PROGRESS]) for data in found[1 : first + 1])
    target = POSES[int(found[first - 1][keys.GOAL_NODE]), :2]
    at_first = POSES[int(found[0][keys.PLACE]), :2]
    # At least as far as the crow flies, but for the last step and its belief's errors.
    assert told > float((target - at_first).norm()) - 2
    assert float(found[0][keys.PROGRESS]) == 0


def test_a_controller_without_practice_changes_nothing() -> None:
    sensed = walk(practising(), 40)
    plain = practising(lambda embedding, senses, free: free)
    for one, other in zip(sensed, walk(plain, 40), strict=True):
        assert int(one[keys.ACTION]) == int(other[keys.ACTION])
        torch.testing.assert_close(one[keys.SENSES], other[keys.SENSES])


def test_it_acts_as_its_controller_says() -> None:
    always_left = practising(lambda embedding, senses, free: free * 0 + EAST)
    assert {int(data[keys.ACTION]) for data in walk(always_left, 12)} == {1}


#: Logits of the second action alone.
EAST = torch.tensor([[0.0, 50.0, 0.0]])


def test_a_target_that_it_cannot_reach_is_given_up() -> None:
    on_the_spot = practising(lambda embedding, senses, free: free * 0 + EAST)
    found = walk(on_the_spot, 202)
    # 200 decisions without being there; it may begin beside its target.
    assert any(bool(data[keys.GAVE_UP]) for data in found)


def sense(senses: SteeringSenses, x: float, view: tuple[float, float]) -> torch.Tensor:
    """What an agent at ``(x, 1)`` senses that looks along y."""
    return senses(
        torch.tensor([[x, 1.0, 90.0]]),
        torch.tensor([0.5]),
        torch.tensor([[[1.0, 9.0]]]),
        torch.tensor([[5.0, 1.0]]),
        torch.tensor([True]),
        torch.tensor([2]),
        torch.tensor([view]),
        torch.tensor([[-1.0, -1.5, -9.0]]),
    )[0]


def test_senses_are_seen_from_the_agent() -> None:
    senses = SteeringSenses(1, 3, 2)
    sense(senses, 2.5, (3.0, 0.0))
    found = sense(senses, 1.0, (3.0, 4.0))
    # Points 1, 2, 3.5, 5 and 7 steps along the path are ahead; the aim, 4 to the east,
    # is to the right. A fourth of a step counts, up to 2.
    ahead = torch.tensor([1.0, 2.0, 3.5, 5.0, 7.0, 0.0]) / 4
    torch.testing.assert_close(found[:6], ahead, atol=1e-5, rtol=0)
    left = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, -1.0])
    torch.testing.assert_close(found[6:12], left, atol=1e-5, rtol=0)
    # At its end; moved by 1.5; four fifths of the view are new; spread.
    felt = torch.tensor([1.0, 1.5, 0.8, 0.5])
    torch.testing.assert_close(found[12:16], felt)
    # The last action; the second is half a decision worse, the third 2 at most.
    assert found[16:].tolist() == [0, 0, 1, 0, -0.5, -2]
    assert len(found) == SteeringSenses.size(3)


def test_in_a_first_decision_nothing_is_sensed_of_what_was_before() -> None:
    senses = SteeringSenses(1, 3, 2)
    first = sense(senses, 1.0, (3.0, 4.0))
    # Moved as far as counts, a view that is all new, and no last action.
    assert first[13:15].tolist() == [2, 1]
    assert first[16:19].tolist() == [0, 0, 0]
    assert sense(senses, 1.0, (3.0, 4.0))[13:15].tolist() == [0, 0]
    senses.forget(torch.tensor([True]))
    assert torch.equal(sense(senses, 1.0, (3.0, 4.0)), first)


def test_an_episode_begins_without_what_the_last_one_left() -> None:
    navigator, starts = practising(confirm=1.0), []
    walk(navigator, 3)
    navigator._unconfirmed = lambda start, goal: starts.append(start) or 0
    data = navigator(look((13.5, 9.1, 90.0), begins=True))
    assert set(starts) == {-1}
    assert data[keys.SENSES][0, 13:15].tolist() == [2, 1]


def test_edges_are_what_was_walked() -> None:
    # From below to above, through the block in the middle: four steps that nobody can
    # make, where half of the way round is 22.
    known = make().map
    ends = [ROUND.index(place) * 4 + 1 for place in ((6.9, 2.5), (6.9, 13.5))]
    more = torch.cat([known.edges, torch.tensor([ends])])
    cost = torch.cat([known.edge_cost, torch.tensor([4.0])])
    navigator = practising(map=replace(known, edges=more, edge_cost=cost))
    found = walk(navigator, 250)
    trials = navigator.trials
    assert trials.passed[-1].tolist() == [0, 0]
    assert trials.mistaken.nonzero().tolist() == [[len(more) - 1]]
    # Others were passed, and took about as long as steps and turns do.
    tried = trials.tried[:-1] > 0
    assert trials.passed[:-1].sum() / trials.tried[:-1].sum() > 0.75
    took = (trials.walked / trials.passed)[:-1][tried & trials.confirmed[:-1]]
    assert 1 <= took.median() <= 8
    # It costs more than it did, plans do without it, and targets are reached.
    assert trials.costs(cost)[-1].max() > 8
    assert not trials.kept(len(POSES))[-1]
    assert sum(bool(data[keys.REACHED]) for data in found[-120:]) >= 1


def test_a_map_without_edges_gives_no_trials() -> None:
    known = make().map
    alone = replace(known, edges=known.edges[:0], edge_cost=known.edge_cost[:0])
    navigator = practising(map=alone)
    found = walk(navigator, 3)
    assert navigator.trials.tried.shape == (0, 2)
    assert {0, 1, 2} >= {int(data[keys.ACTION]) for data in found}


def test_edges_may_cost_more_on_the_way_back() -> None:
    known = make().map
    both = torch.stack([known.edge_cost] * 2, 1)
    found = walk(practising(map=replace(known, edge_cost=both)), 30)
    for one, other in zip(found, walk(practising(), 30), strict=True):
        assert torch.equal(one[keys.ACTION], other[keys.ACTION])
        assert torch.equal(one[keys.PATH_COST], other[keys.PATH_COST])


def test_plans_cost_what_trials_showed() -> None:
    navigator = practising()
    trials, known = navigator.trials, navigator.map
    some = known.edges[::2]
    trials.add(some, torch.arange(len(some)) % 3 > 0, torch.full((len(some),), 9))
    goal = int(navigator(look(START, begins=True))[keys.GOAL_NODE])
    costs = trials.costs(known.edge_cost)
    expected = Planner(len(POSES), known.edges, costs).plan([goal]).costs
    torch.testing.assert_close(navigator.plans.costs[0], expected)
    plain = Planner(len(POSES), known.edges, known.edge_cost).plan([goal]).costs
    assert (expected - plain).abs().max() > 0.5


def test_targets_are_chosen_to_confirm_edges(monkeypatch) -> None:
    monkeypatch.setattr(practising_navigator, "_LATE", 0)
    # All edges were passed but those on one side, from the corner where the agents are.
    new = (POSES[edges()][..., 0] < 3).all(1)
    shares = []
    for confirm in (0.0, 1.0):
        navigator = practising(confirm=confirm)
        for counts in (navigator.trials.passed, navigator.trials.walked):
            counts[~new] = 1
        # An agent that begins knows no place yet; each takes its second target now.
        for begins in (True, False):
            data = TensorDict.cat([look((2.5, 2.5, 0.0), begins=begins)] * 48)
            targets = navigator(data)[keys.GOAL_NODE].flatten()
        x, y, _ = POSES[targets].unbind(1)
        shares.append(float((y > x).float().mean()))
    # To half of the places the way is over that side; of four waypoints one is there in
    # all but 0.5 ** 4 of the draws.
    assert shares[0] < 0.7
    assert shares[1] > 0.8


def test_the_share_of_such_targets_is_one() -> None:
    with pytest.raises(ValueError, match=r"confirm must be in \[0, 1\], got 2"):
        practising(confirm=2.0)
