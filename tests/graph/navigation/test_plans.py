import pytest
import torch

from toponav.graph.navigation.goals import GoalNodes
from toponav.graph.navigation.planner import Planner
from toponav.graph.navigation.plans import Plans

# A ring of six: from 0 to 3 by way of 1 and 2, or of 5 and 4.
RING = torch.tensor([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 0]])


@pytest.fixture
def plans():
    """One agent, whose goal is 3."""
    goals = GoalNodes(1, 1, 4, patience=20)
    goals.nodes[0], goals.counts[0] = 3, True
    made = Plans(Planner(6, RING, torch.ones(6)), goals)
    made.plan([0])
    return made


def closed(plans):
    return RING[plans.closed[0]].tolist()


def test_a_cut_closes_what_leads_over_its_level(plans):
    # From 1 the goal is 2 away, over 2; with it closed, 4 away, around.
    assert plans.close(0, 1, 2.0, hops=0) == 2
    assert closed(plans) == [[1, 2]]
    assert plans.cost(torch.tensor([1])).item() == 4.0
    assert plans.ahead(torch.tensor([1]), 5).tolist() == [[0, 5, 4, 3, 3]]


def test_one_edge_alone_is_closed() -> None:
    # From 0 two ways lead on at the same cost, over 1 and over 3.
    square = torch.tensor([[0, 1], [1, 2], [2, 3], [0, 3]])
    goals = GoalNodes(1, 1, 4, patience=20)
    goals.nodes[0], goals.counts[0] = 2, True
    plans = Plans(Planner(4, square, torch.ones(4)), goals)
    plans.plan([0])
    assert plans.close_edge(0, 0) == 1
    assert square[plans.closed[0]].tolist() == [[0, 1]]
    # The other way is the plan now; closed too, it leaves none.
    assert plans.ahead(torch.tensor([0]), 2).tolist() == [[3, 2]]
    assert plans.close_edge(0, 0) == 3
    assert plans.cost(torch.tensor([0])).isinf()
    plans.open_up(torch.tensor([0]))
    assert square[plans.closed[0]].tolist() == [[0, 1]]


def test_edges_that_are_closed_together_open_together(plans) -> None:
    # From 0 the path leads over 1 and 2; of the two edges, 1-2 comes first on it.
    assert plans.has_path.all()
    assert plans.close_all(0, 0, torch.tensor([3, 1])) == (1, 2)
    assert closed(plans) == [[1, 2], [3, 4]]
    assert plans.num_cuts.tolist() == [1]
    # 2 and 3 are left on one side, all others on the other.
    assert plans.has_path.tolist() == [[False, False, True, True, False, False]]
    assert plans.reopen_first(0)
    assert closed(plans) == []


def test_edges_that_are_not_on_the_path_close_too(plans) -> None:
    assert plans.close_all(0, 1, torch.tensor([3])) == (-1, -1)
    assert closed(plans) == [[3, 4]]
    assert plans.cost(torch.tensor([4])).item() == 5.0


@pytest.mark.parametrize("hops", [2, 3, 20])
def test_a_cut_leaves_a_way_if_there_is_one(plans, hops):
    # Two hops from 1 lies 5, whose edge to 4 crosses the level too: both ways would be
    # closed. With half as many hops, it is 1-2 alone.
    plans.close(0, 1, 2.0, hops=hops)
    assert closed(plans) == [[1, 2]]


def test_what_is_closed_at_last_opens_again(plans):
    plans.close(0, 1, 2.0, hops=0)
    plans.close(0, 5, 2.0, hops=0)
    assert closed(plans) == [[1, 2], [4, 5]]
    assert plans.cost(torch.tensor([0])).isinf()
    plans.open_up(torch.tensor([0]))
    assert closed(plans) == [[1, 2]]
    assert plans.cost(torch.tensor([0])).item() == 3.0
