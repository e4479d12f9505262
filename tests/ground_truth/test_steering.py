import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, strategies as st

from tests.fakes import WORLD
from toponav.ground_truth import Steering, bearing, cell_centres, wrap_degrees
from toponav.ground_truth.steering import point_ahead


def test_row_0_is_in_the_north():
    # 3 rows of 128: the middle of row 0 is 2.5 * 128 up, of row 2 half a cell.
    cells = torch.tensor([[0, 0], [2, 1]])
    assert cell_centres(cells, 3, 128.0).tolist() == [[64.0, 320.0], [192.0, 64.0]]


@pytest.mark.parametrize(
    ("x", "y", "degrees"), [(1, 0, 0), (0, 1, 90), (-1, 0, 180), (0, -1, -90)]
)
def test_bearing_is_counter_clockwise_from_east(x, y, degrees):
    end = torch.tensor([float(x), float(y)])
    assert bearing(torch.zeros(2), end).item() == pytest.approx(degrees, abs=1e-4)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angle_is_the_same_direction(angle):
    wrapped = wrap_degrees(torch.tensor(angle, dtype=torch.float64)).item()
    assert -180 <= wrapped < 180
    assert math.cos(math.radians(wrapped - angle)) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(
    ("off", "action"),
    [
        (0, "forward"),
        (10, "forward"),
        (-10, "forward"),
        (11, "forward+left"),
        (-11, "forward+right"),
        (61, "left"),
        (-61, "right"),
        (-180, "right"),
    ],
)
def test_action_for_each_angle(off, action):
    found = Steering(WORLD).towards(torch.tensor([float(off)]))
    assert WORLD.actions[found.item()] == action


def test_actions_are_looked_up_by_name_in_any_order():
    shuffled = replace(WORLD, actions=(*reversed(WORLD.actions), "shoot"))
    found = Steering(shuffled).towards(torch.tensor([0.0, 30.0, -90.0]))
    names = [shuffled.actions[number] for number in found]
    assert names == ["forward", "forward+left", "right"]


def test_worlds_without_poses_or_actions_are_refused():
    with pytest.raises(ValueError, match="world must report poses"):
        Steering(replace(WORLD, motion=None))
    with pytest.raises(ValueError, match=r"must have the actions forward, .* got up"):
        Steering(replace(WORLD, actions=("up", "down")))


@pytest.mark.parametrize(
    ("position", "aim"),
    [
        ((0.0, 0.0), (128.0, 32.0)),  # 160 along a path that turns north at 128
        ((-60.0, 30.0), (100.0, 0.0)),  # 60 before the first point
        ((64.0, -20.0), (128.0, 96.0)),
        ((128.0, 0.0), (128.0, 128.0)),  # the path ends there
    ],
)
def test_point_ahead_runs_along_the_path(position, aim):
    path = torch.tensor([[[0.0, 0.0], [128.0, 0.0], [128.0, 128.0], [128.0, 128.0]]])
    here = torch.tensor([position])
    found = point_ahead(path, here, cell_size=128.0, lookahead=160.0)
    assert found.tolist() == [list(aim)]


def test_point_ahead_of_a_path_that_goes_nowhere_is_its_point():
    path = torch.full((1, 4, 2), 64.0)
    found = point_ahead(path, torch.tensor([[9.0, 9.0]]), cell_size=128, lookahead=160)
    assert found.tolist() == [[64.0, 64.0]]
