import networkx as nx
import pytest
import torch
from hypothesis import given, settings, strategies as st

from toponav.graph.navigation.planner import Planner

LINE = torch.tensor([[0, 1], [1, 2], [2, 3]])


@st.composite
def graphs(draw):
    """Number of nodes, edges, costs, closed edges and goals."""
    nodes = draw(st.integers(1, 12))
    pairs = [(i, j) for i in range(nodes) for j in range(i + 1, nodes)]
    edges = draw(st.lists(st.sampled_from(pairs), unique=True)) if pairs else []
    count = len(edges)
    cost = draw(st.lists(st.sampled_from([1.0, 3.0]), min_size=count, max_size=count))
    closed = draw(st.lists(st.booleans(), min_size=count, max_size=count))
    goals = draw(st.lists(st.integers(0, nodes - 1), max_size=3))
    return nodes, edges, cost, closed, goals


@settings(max_examples=60)
@given(graphs())
def test_costs_are_those_of_another_library_and_ways_use_no_closed_edge(drawn):
    nodes, edges, cost, closed, goals = drawn
    numbered = torch.tensor(edges, dtype=torch.int64).reshape(-1, 2)
    planner = Planner(nodes, numbered, torch.tensor(cost))
    plan = planner.plan(goals, torch.tensor(closed, dtype=torch.bool))
    left = nx.Graph()
    left.add_nodes_from(range(nodes))
    for (i, j), weight, is_closed in zip(edges, cost, closed, strict=True):
        if not is_closed:
            left.add_edge(i, j, weight=weight)
    known = nx.multi_source_dijkstra_path_length(left, set(goals)) if goals else {}
    assert plan.costs.tolist() == [known.get(n, torch.inf) for n in range(nodes)]
    for node in range(nodes):
        following = int(plan.onward[node])
        if following == node:
            assert node in goals or node not in known
            continue
        # A step along an open edge, whose cost is the difference.
        step = left.edges[node, following]["weight"]
        assert known[node] == step + known[following]


def test_with_all_routes_closed_there_is_no_way():
    # networkx returns a path of infinite length here; a plan has none.
    plan = Planner(4, LINE, torch.ones(3)).plan([3], torch.tensor([False, True, False]))
    assert plan.costs.tolist() == [torch.inf, torch.inf, 1.0, 0.0]
    assert plan.onward.tolist() == [0, 1, 3, 3]


def test_the_nearest_of_several_goals_is_chosen():
    plan = Planner(4, LINE, torch.tensor([1.0, 1.0, 5.0])).plan([0, 3])
    # From 2: 2 to the left, 5 to the right.
    assert plan.costs.tolist() == [0.0, 1.0, 2.0, 0.0]
    assert plan.onward.tolist() == [0, 0, 1, 3]


def test_a_plan_leaves_the_planner_as_it_was():
    planner = Planner(4, LINE, torch.ones(3))
    first = planner.plan([3])
    planner.plan([0], torch.ones(3, dtype=torch.bool))
    assert torch.equal(planner.plan([3]).costs, first.costs)


def test_without_edges_only_the_goal_is_at_the_goal():
    plan = Planner(2, torch.empty(0, 2, dtype=torch.int64), torch.empty(0)).plan([1])
    assert plan.costs.tolist() == [torch.inf, 0.0]


def test_edges_are_found_by_their_ends():
    planner = Planner(4, torch.tensor([[1, 2], [0, 3], [0, 1]]), torch.ones(3))
    start, end = torch.tensor([[0, 3], [2, 2]]), torch.tensor([[1, 0], [1, 3]])
    assert planner.edge_numbers(start, end).tolist() == [[2, 1], [0, -1]]


def test_edges_across_a_level_near_a_waypoint():
    # Two paths to 5, which are joined at the start: 0-1-2-5 and 0-3-4-5.
    edges = torch.tensor([[0, 1], [1, 2], [2, 5], [0, 3], [3, 4], [5, 4], [0, 2]])
    planner = Planner(6, edges, torch.tensor([1.0] * 6 + [3.0]))
    costs = planner.plan([5]).costs
    assert costs.tolist() == [3.0, 2.0, 1.0, 2.0, 1.0, 0.0]

    def across(node, level, hops, closed=(False,) * 7):
        closed = torch.tensor(closed)
        return planner.edges_across(node, costs, level, closed, hops=hops).tolist()

    # From 1, which is 2 away: 1-2 alone; with 0, the leap 0-2; with 3, 3-4 too.
    assert across(1, 2.0, hops=0) == [1]
    assert across(1, 2.0, hops=1) == [1, 6]
    assert across(1, 2.0, hops=2) == [1, 4, 6]
    # An edge that is closed is neither walked nor closed again.
    assert across(1, 2.0, hops=2, closed=[True] + [False] * 6) == [1]
    # Whichever of its ends an edge names first.
    assert across(4, 1.0, hops=0) == [5]
    # Nothing is looked at from beyond the level but its own edges back.
    assert across(0, 3.0, hops=3) == [0, 3, 6]


@pytest.mark.parametrize(
    ("edges", "cost", "message"),
    [
        ([[0, 4]], [1.0], "must join waypoints 0 to 3, got 0 to 4"),
        ([[0, 1]], [0.0], "finite and above 0, got 0 to 0"),
        ([[0, 1], [1, 2]], [1.0, torch.inf], "finite and above 0, got 1 to inf"),
    ],
)
def test_wrong_edges_are_refused(edges, cost, message):
    with pytest.raises(ValueError, match=message):
        Planner(4, torch.tensor(edges), torch.tensor(cost))


def test_a_way_can_cost_more_back_than_there():
    # A triangle 0-1-2: there 1 each; back 5 over each edge of the path 0-1-2, and the
    # edge 0-2 costs 4 in both directions.
    edges = torch.tensor([[0, 1], [1, 2], [0, 2]])
    cost = torch.tensor([[1.0, 5.0], [1.0, 5.0], [4.0, 4.0]])
    planner = Planner(3, edges, cost)
    there = planner.plan([2])  # 0-1-2 costs 1 + 1 = 2, less than 4
    assert (there.costs.tolist(), there.onward.tolist()) == ([2, 1, 0], [1, 2, 2])
    back = planner.plan([0])  # 2-0 costs 4; 1-0 costs 5, as 1-2-0 does
    assert (back.costs.tolist(), back.onward.tolist()) == ([0, 5, 4], [0, 0, 0])
    # A closed edge is closed in both directions.
    closed = torch.tensor([False, False, True])
    assert planner.plan([0], closed).costs.tolist() == [0, 5, 10]
