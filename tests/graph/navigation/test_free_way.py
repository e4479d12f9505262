"""Aims around what a view says is not free."""

import pytest
import torch

from toponav.graph.navigation.free_way import aim_where_free
from toponav.graph.poses import BEARINGS, DISTANCES

EAST = torch.tensor([[0.0, 0.0, 0.0]])


def all_free() -> torch.Tensor:
    return torch.ones(1, len(BEARINGS), len(DISTANCES))


def test_where_all_is_free_it_is_the_straight_line() -> None:
    # The spot four steps ahead is the aim itself; one at 4.5 would be half a step off.
    aim = torch.tensor([[4.0, 0.0]])
    assert aim_where_free(EAST, aim, all_free()).tolist() == [[4.0, 0.0]]


def test_a_wall_on_the_line_is_passed_where_the_view_says() -> None:
    aim, chance = torch.tensor([[4.0, 0.0]]), all_free()
    # A thin wall 1.5 steps ahead, for the bearings from -15 to the left end; what is
    # behind it is free, and not to be come to.
    chance[:, BEARINGS > -20, 2] = 0.0
    (found,) = aim_where_free(EAST, aim, chance).tolist()
    # At -30 degrees the nearest point to the aim is 4 cos(30) = 3.46 steps away: the
    # spot at 3.5, 2.00 from the aim, saves 2.00 of the four steps.
    assert found == pytest.approx([3.5 * 0.8660, -3.5 * 0.5], abs=1e-3)


def test_a_doubtful_way_is_taken_if_nothing_else_saves_steps() -> None:
    aim, chance = torch.tensor([[4.0, 0.0]]), torch.zeros(1, 13, 12)
    # Four steps, each free with 0.9: 0.9 ** 8 = 0.43 of 4 steps, the most.
    chance[:, 6] = 0.9
    assert aim_where_free(EAST, aim, chance).tolist() == [[4.0, 0.0]]


def test_the_aim_stays_where_nothing_is_worth_it_or_it_is_near() -> None:
    aim = torch.tensor([[4.0, 0.0]])
    assert aim_where_free(EAST, aim, torch.zeros(1, 13, 12)).equal(aim)
    behind = torch.tensor([[-4.0, 0.0]])
    # All spots are before the agent and save nothing.
    assert aim_where_free(EAST, behind, all_free()).equal(behind)
    # A spot is 0.1 steps beside it, and worth 1.3.
    near = torch.tensor([[1.4, 0.0]])
    assert aim_where_free(EAST, near, all_free()).equal(near)


def test_each_agent_has_its_own() -> None:
    poses = torch.tensor([[0.0, 0.0, 0.0], [10.0, 10.0, 90.0]])
    aims = torch.tensor([[4.0, 0.0], [10.0, 14.0]])
    chance = torch.cat([all_free(), all_free()])
    chance[1, 5:8, 2:] = 0.0
    found = aim_where_free(poses, aims, chance)
    assert found[0].equal(aims[0])
    # To the right or the left of its wall, as far to either side.
    assert (found[1] - aims[1]).norm().item() == pytest.approx(2.0, abs=0.02)
