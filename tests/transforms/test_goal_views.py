import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from tests.checks import check_transform
from tests.fakes import TINY, FakeMaze, parse
from toponav.keys import GOAL_CELL, GOAL_VIEWS
from toponav.transforms import GoalViews

MASK, SLOTS = parse(TINY)
CELLS = torch.tensor([c for c in MASK.nonzero().tolist() if tuple(c) != SLOTS["a"]])
#: Two pictures of each cell; every pixel is the cell's number, or 100 more.
NUMBERS = torch.arange(len(CELLS), dtype=torch.uint8)
VIEWS = torch.stack([NUMBERS, NUMBERS + 100], 1)[..., None, None, None].expand(
    -1, -1, 2, 3, 3
)


def make_env(batch_size=(), **arguments):
    return FakeMaze(TINY, batch_size=batch_size, max_decisions=4, **arguments)


def make_transform():
    return GoalViews(CELLS, VIEWS)


def expected(goal):
    """Number of the cell of each goal, [*B]."""
    return (goal.unsqueeze(-2) == CELLS).all(-1).int().argmax(-1)


def test_it_stands_what_every_transform_must():
    check_transform(make_env, make_transform)


def test_the_pictures_are_those_of_the_goals_cell_in_all_decisions():
    env = TransformedEnv(make_env((5,)), make_transform())
    data = env.rollout(12, break_when_any_done=False)
    views, goal = data[GOAL_VIEWS], data[GOAL_CELL]
    # Three episodes of four decisions; goals change with the episode.
    assert (goal[:, 0] != goal[:, 4]).any()
    number = expected(goal)[..., None, None, None]
    assert (views[:, :, 0] == number).all()
    assert (views[:, :, 1] == number + 100).all()
    assert views.shape == (5, 12, 2, 2, 3, 3)
    assert views.dtype is torch.uint8


def test_a_goal_that_moves_is_followed():
    show, nothing = make_transform(), TensorDict(batch_size=[2])
    now = show._reset(nothing, TensorDict({GOAL_CELL: CELLS[[0, 1]]}, [2]))
    for number in (1, 2, 2, 0):
        then = TensorDict({GOAL_CELL: CELLS[[0, number]]}, [2])
        now = show._step(now, then)
        assert now[GOAL_VIEWS][:, 0, 0, 0, 0].tolist() == [0, number]


def test_a_goal_without_pictures_is_refused():
    env = TransformedEnv(make_env(), GoalViews(CELLS[:1] * 0, VIEWS[:1]))
    with pytest.raises(ValueError, match=r"a cell with views, got \[\d, \d\]"):
        env.reset()


@pytest.mark.parametrize(
    ("views", "shape"), [(VIEWS[:2], r"\(2, 2, 2, 3, 3\)"), (VIEWS[:, 0], r"\(7, 2")]
)
def test_as_many_pictures_as_cells_are_needed(views, shape):
    with pytest.raises(ValueError, match=rf"views must be \[7, V, H, W, C\].* {shape}"):
        GoalViews(CELLS, views)


def test_an_env_without_goals_is_refused():
    show = GoalViews(CELLS, VIEWS, in_keys=["somewhere"])
    with pytest.raises(ValueError, match="'somewhere' must be an observation"):
        assert TransformedEnv(make_env(), show).observation_spec
