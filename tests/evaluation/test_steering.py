import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from toponav.evaluation import Action, Motion
from toponav.evaluation.steering import (
    bearing,
    cell_centres,
    point_ahead,
    steer,
    wrap_degrees,
)


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
        (0, Action.FORWARD),
        (10, Action.FORWARD),
        (-10, Action.FORWARD),
        (11, Action.FORWARD_LEFT),
        (-11, Action.FORWARD_RIGHT),
        (61, Action.LEFT),
        (-61, Action.RIGHT),
        (-180, Action.RIGHT),
    ],
)
def test_action_for_each_angle(off, action):
    assert steer(torch.tensor([float(off)]), turn=20.0, widest=60.0).item() == action


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


def test_a_cell_takes_3_9_decisions():
    assert Motion().decisions_per_cell == pytest.approx(3.867, abs=1e-3)
