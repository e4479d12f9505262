"""Actions that are no numbers of actions are refused, and not read as others."""

from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase

from tests.envs.layouts import GATE
from toponav.envs import MazeEnv, make_pixel_env
from toponav.policies import RandomPolicy


class Plain(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(0, 255, (8, 8, 3), np.uint8)
    action_space = gymnasium.spaces.Discrete(6)

    def reset(self, *, seed=None, options=None):
        return self.observation_space.low, {}

    def step(self, action):
        return self.observation_space.low, 0.0, False, False, {}


gymnasium.register("tests/Plain-v0", Plain)


@pytest.fixture(params=["maze", "gym"], scope="module")
def env(request: pytest.FixtureRequest) -> Iterator[EnvBase]:
    if request.param == "maze":
        made: EnvBase = MazeEnv(GATE, batch_size=2)
    else:
        made = make_pixel_env("tests/Plain-v0", batch_size=2, episode_length=9, seed=0)
    made.reset()
    yield made
    made.close()


@pytest.mark.parametrize(
    ("action", "sentence"),
    [
        (
            torch.eye(6, dtype=torch.int64)[:2],
            r"integers of the shape \[2\] .*one_hot=F",
        ),
        (torch.zeros(2), r"integers of the shape \[2\]"),
        (torch.tensor([0, 6]), r"in \[0, 6\), got 6"),
        (torch.tensor([-1, 0]), r"in \[0, 6\), got -1"),
    ],
)
def test_what_is_no_action_is_refused(
    env: EnvBase, action: torch.Tensor, sentence: str
) -> None:
    with pytest.raises(ValueError, match=f"action must be {sentence}"):
        env._step(TensorDict({"action": action}, [2]))


def test_a_step_without_an_action_is_refused(env: EnvBase) -> None:
    with pytest.raises(KeyError, match="a step must have 'action'"):
        env._step(TensorDict(batch_size=[2]))


def test_a_policy_for_one_hot_actions_is_refused(env: EnvBase) -> None:
    with pytest.raises((ValueError, RuntimeError)):
        env.rollout(2, RandomPolicy(6, one_hot=True))


@pytest.mark.parametrize("shape", [(2,), (2, 1)])
def test_numbers_are_taken_in_both_shapes(env: EnvBase, shape: tuple[int, ...]) -> None:
    action = torch.tensor([0, 5]).reshape(shape)
    assert env._step(TensorDict({"action": action}, [2]))["pixels"].shape[0] == 2


def test_rows_that_do_not_step_may_hold_anything(env: EnvBase) -> None:
    asked = {"action": torch.tensor([0, 77]), "_step": torch.tensor([True, False])}
    assert env._step(TensorDict(asked, [2]))["pixels"].shape[0] == 2
