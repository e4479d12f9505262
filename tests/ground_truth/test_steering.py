import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, strategies as st

from tests.fakes import WORLD
from toponav.ground_truth import Steering, bearing, cell_centres, wrap_degrees
from toponav.ground_truth.routes import point_ahead
from toponav.worlds import Effect


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


def world_of(*effects):
    motion = replace(WORLD.motion, effects=effects)
    names = tuple(f"action {number}" for number in range(len(effects)))
    return replace(WORLD, actions=names, motion=motion)


def test_actions_are_looked_up_by_effect_in_any_order():
    world = world_of(Effect(), *reversed(WORLD.motion.effects))
    found = Steering(world).towards(torch.tensor([0.0, 30.0, -90.0, 90.0]))
    assert found.tolist() == [6, 2, 3, 4]


def test_turns_on_the_spot_and_on_the_way_stand_in_for_each_other():
    world = world_of(Effect(turn=-20), Effect(5.0), Effect(4.0, 1.0, turn=20))
    found = Steering(world).towards(torch.tensor([0.0, 30.0, 90.0, -30.0, -90.0]))
    assert found.tolist() == [1, 2, 2, 0, 0]


def test_worlds_without_poses_or_actions_are_refused():
    with pytest.raises(ValueError, match="world must report poses"):
        Steering(replace(WORLD, motion=None))
    with pytest.raises(ValueError, match=r"turn to both sides, got action 0, action"):
        Steering(world_of(Effect(5.0), Effect(turn=20.0)))


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


def test_it_goes_straight_on_where_actions_go_aslant_too():
    # The first one goes ahead and to the left at once, and turns no more than the last.
    actions = ("aslant", *WORLD.actions)
    effects = (Effect(ahead=9.0, left=9.0), *WORLD.motion.effects)
    motion = replace(WORLD.motion, effects=effects)
    steering = Steering(replace(WORLD, actions=actions, motion=motion))
    assert actions[steering.ahead] == "forward"
