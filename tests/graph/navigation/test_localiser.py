import pytest
import torch

from tests.graph.grid_world import GOAL, RING, START, GridMap, compare
from toponav.graph import Localiser, NavigatorRules
from toponav.graph.navigation.goals import GoalNodes
from toponav.graph.navigation.sampler import ActionSampler


@pytest.fixture
def grid():
    return GridMap(RING)


def make(grid, num_agents=1, **rules):
    rules = NavigatorRules(**({"tc_reach": 0.4} | rules))
    return Localiser(grid, compare, rules, num_agents)


def at(*cells):
    return torch.tensor(cells, dtype=torch.float32)


def test_a_view_is_at_the_waypoint_most_like_it(grid):
    assert make(grid).locate(at((1.0, 2.4))).item() == grid.number((1, 2))


def test_a_view_like_none_is_nowhere_and_is_looked_for_again(grid):
    localiser = make(grid)
    assert localiser.locate(at(START)).item() == grid.number(START)
    assert localiser.locate(at((50, 50))).item() == -1
    assert localiser.locate(at(GOAL)).item() == grid.number(GOAL)


def test_it_looks_near_the_last_place_first(grid):
    # One square from the last place and half a square off it, though another square is
    # exactly like the view: the first is in reach, and so nobody asks the other.
    def seen(one, many):
        away = (one.unsqueeze(1) - many).abs().sum(-1)
        return torch.where((many == at(GOAL)).all(-1), 0.9, (1 - away / 4).clamp(min=0))

    localiser = Localiser(grid, seen, NavigatorRules(tc_reach=0.4, hops=1), 1)
    localiser.place = torch.tensor([grid.number(START)])
    view = at((1, 2))
    assert localiser.locate(view).item() == grid.number((1, 2))
    localiser.place = torch.tensor([-1])
    # 1 at (1, 2) itself; from (1, 2.5) it would be 0.875, less than the goal's 0.9.
    assert localiser.locate(at((1, 2.5))).item() == grid.number(GOAL)
    localiser.place = torch.tensor([grid.number(START)])
    assert localiser.locate(at((1, 2.5))).item() == grid.number((1, 2))


def test_it_looks_along_its_path_before_all_else(grid):
    # (1, 2.5) is as much like the square on either side, 1 / (1 + 0.5^2) = 0.8, and the
    # lower number wins, if no path leads to the other.
    localiser = make(grid, 2)
    localiser.place = torch.full((2,), grid.number(START))
    path = torch.tensor([[grid.number((1, 3)), grid.number((1, 4))], [-1, -1]])
    found = localiser.locate(at((1, 2.5), (1, 2.5)), path)
    assert found.tolist() == [grid.number((1, 3)), grid.number((1, 2))]


def test_a_path_that_is_not_like_the_view_is_left(grid):
    localiser = make(grid, 1)
    localiser.place = torch.tensor([grid.number(START)])
    path = torch.tensor([[grid.number((1, 2)), grid.number((1, 3))]])
    assert localiser.locate(at(GOAL), path).item() == grid.number(GOAL)


def test_who_has_no_place_is_on_no_path(grid):
    localiser = make(grid, 1)
    path = torch.tensor([[grid.number((1, 3))]])
    assert localiser.locate(at((1, 2.4)), path).item() == grid.number((1, 2))


def test_agents_look_around_their_own_places(grid):
    localiser = make(grid, 3)
    first = localiser.locate(at(START, GOAL, (4, 3)))
    assert first.tolist() == [grid.number(cell) for cell in (START, GOAL, (4, 3))]
    second = localiser.locate(at((1, 2), (50, 50), (4, 4)))
    assert second.tolist() == [grid.number((1, 2)), -1, grid.number((4, 4))]


def test_goal_views_that_pass_count_and_without_any_the_best(grid):
    goals, localiser = GoalNodes(2, 2, 2, patience=None), make(grid)
    views = torch.stack([at(GOAL, (30, 30)), at((30, 30), (20, 20))])
    goals.begin(torch.tensor([0, 1]), views, localiser)
    assert goals.active.tolist() == [[True, False], [False, True]]
    assert goals.nodes[0, 0].item() == grid.number(GOAL)


def test_a_goal_that_delivers_in_time_is_never_dropped(grid):
    goals = GoalNodes(1, 1, 2, patience=3)
    goals.begin(torch.tensor([0]), at(GOAL).unsqueeze(0), make(grid))
    place = torch.tensor([grid.number(GOAL)])
    for _ in range(5):
        assert not any(goals.wait(place).item() for _ in range(2))
        goals.restart(torch.tensor([True]))


def make_sampler(**rules):
    """For one agent."""
    generator = torch.Generator().manual_seed(0)
    return ActionSampler(1, NavigatorRules(tc_reach=0.4, **rules), generator)


def draw(sampler, logits, number, known=True):
    view = torch.ones(1, 2)
    drawn = [
        sampler.draw(torch.tensor([logits]), torch.tensor([known]), view).item()
        for _ in range(number)
    ]
    return torch.bincount(torch.tensor(drawn), minlength=len(logits)) / number


@pytest.mark.parametrize("temperature", [0.5, 1.0])
def test_actions_are_drawn_by_their_softmax(temperature):
    sampler = make_sampler(temperature=temperature)
    logits = [0.0, 1.0, 0.5]
    expected = (torch.tensor(logits) / temperature).softmax(0)
    # Five standard deviations of 2000 draws: 5 * sqrt(0.25 / 2000) = 0.056.
    torch.testing.assert_close(
        draw(sampler, logits, 2000), expected, atol=0.056, rtol=0
    )


def test_the_lost_draw_from_all_actions_alike():
    sampler = make_sampler(temperature=0.0)
    share = draw(sampler, [0.0, 9.0, 0.0], 2000, known=False)
    torch.testing.assert_close(share, torch.full((3,), 1 / 3), atol=0.056, rtol=0)
    assert draw(sampler, [0.0, 9.0, 0.0], 5).tolist() == [0.0, 1.0, 0.0]


def test_noop_actions_are_left_out_until_all_are():
    # The view never changes: each action is drawn once in three decisions.
    sampler = make_sampler(temperature=0.0, mask_noop_actions=True)
    known, view = torch.tensor([True]), torch.ones(1, 2)
    drawn = [
        sampler.draw(torch.tensor([[2.0, 1.0, 0.0]]), known, view).item()
        for _ in range(6)
    ]
    assert drawn == [0, 1, 2, 0, 1, 2]


def test_a_shortlist_finds_what_a_look_at_all_finds(grid):
    # The grid's similarity falls with the straight distance, so that both agree.
    long, short = make(grid, 3), make(grid, 3, shortlist=4)
    for views in (at(START, GOAL, (4, 3)), at((1, 2.3), (50, 50), (4, 4.2))):
        assert torch.equal(long.locate(views), short.locate(views))
        for one, other in zip(long.nearest(views), short.nearest(views), strict=True):
            torch.testing.assert_close(one, other)
