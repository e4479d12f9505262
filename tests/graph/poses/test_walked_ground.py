"""Where agents have walked, and the spots before them."""

import pytest
import torch

from toponav.graph.poses import BEARINGS, DISTANCES, WalkedGround, spots


def corridors() -> torch.Tensor:
    """Views all over an L: 20 steps to the east, then 10 to the north, 3 wide."""
    torch.manual_seed(0)
    east = torch.rand(4000, 2) * torch.tensor([20.0, 3.0])
    north = torch.rand(2000, 2) * torch.tensor([3.0, 10.0])
    return torch.cat([east, north + torch.tensor([17.0, 0.0])])


def test_what_was_walked_is_free_and_what_is_beside_it_is_not() -> None:
    ground = WalkedGround(corridors())
    inside = torch.tensor([[1.0, 1.5], [10.0, 1.5], [18.5, 8.0]])
    # More than four widths of 0.4 steps beside it, and far beyond the grid.
    beside = torch.tensor([[10.0, 5.0], [15.0, 8.0], [10.0, -2.0], [500.0, -500.0]])
    assert ground.is_free(inside).all()
    assert not ground.is_free(beside).any()


def test_a_few_views_inside_a_wall_do_not_make_it_free() -> None:
    # 3 of 6,000 at one point, where the corridor has some 66 in a square step.
    stray = torch.tensor([[10.0, 6.0]]).expand(3, 2)
    ground = WalkedGround(torch.cat([corridors(), stray]))
    assert not ground.is_free(stray[:1]).item()
    # With 300 it is a place like others.
    stray = stray[:1].expand(300, 2)
    assert WalkedGround(torch.cat([corridors(), stray])).is_free(stray[:1]).item()


def test_spots_are_where_bearings_and_distances_say() -> None:
    poses = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 2.0, 180.0]]])
    found = spots(poses)
    assert found.shape == (1, 2, len(BEARINGS), len(DISTANCES), 2)
    left, far = BEARINGS.tolist().index(90.0), DISTANCES.tolist().index(4.0)
    # Four steps to the left: to the north of one that looks east, and so on.
    assert found[0, 0, left, far].tolist() == pytest.approx([0, 4], abs=1e-5)
    assert found[0, 1, left, far].tolist() == pytest.approx([1, -2], abs=1e-5)


def test_before_an_agent_in_a_corridor_it_is_free_along_it_alone() -> None:
    ground = WalkedGround(corridors())
    free = ground.before(torch.tensor([8.0, 1.5, 0.0]))
    ahead, left = BEARINGS.tolist().index(0.0), BEARINGS.tolist().index(90.0)
    assert free[ahead].all()
    # 1.5 steps to the wall, and a width or two into it.
    assert free[left, DISTANCES < 1.4].all()
    assert not free[left, DISTANCES > 3].any()


def test_no_view_is_refused() -> None:
    with pytest.raises(ValueError, match="positions must be those of one view at lea"):
        WalkedGround(torch.zeros(0, 2))
