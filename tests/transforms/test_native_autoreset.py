"""Envs that begin the next episode themselves, so that nobody sees how one ends."""

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Compose, TransformedEnv

from tests.fakes import FakeMaze
from tests.transforms.test_steps_without_a_reset import PARTS, views_of
from toponav import keys
from toponav.transforms import NoisyTV, PreviousAction, PreviousReward, RandomReward

NONE = 6
#: Decisions of an episode in each env.
LENGTHS = [2, 3, 4]


class NativeMaze(FakeMaze):
    """As IsaacLab's and MJLab's envs are with ``native_autoreset=True``."""

    def __init__(self) -> None:
        super().__init__(batch_size=[3], max_decisions=torch.tensor(LENGTHS))
        self._torchrl_native_autoreset = True

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        last = super()._step(tensordict)
        ended = last.select(keys.REWARD, keys.DONE, keys.TERMINATED, keys.TRUNCATED)
        mask = TensorDict({"_reset": last[keys.DONE]}, self.batch_size)
        ended[keys.REWARD] = torch.full((3, 1), 0.5)
        return self._reset(mask).update(ended)


@pytest.mark.parametrize("name", PARTS)
def test_what_must_see_the_end_of_an_episode_refuses_them(name: str) -> None:
    part, data = PARTS[name](), views_of(2)
    rule = f"native_autoreset must be False for {name}, which .*, got True"
    with pytest.raises(ValueError, match=rule):
        part._reset_on_native_autoreset(data, data)


def test_the_first_step_refuses_them() -> None:
    env = TransformedEnv(NativeMaze(), NoisyTV(size=2, seed=0))
    with pytest.raises(ValueError, match="native_autoreset must be False for NoisyTV"):
        env.rollout(3, break_when_any_done=False)


def test_the_last_action_and_reward_are_those_of_the_same_episode() -> None:
    inputs = PreviousAction(NONE), PreviousReward(in_keys=["reward"]), RandomReward(0)
    env = TransformedEnv(NativeMaze(), Compose(*inputs))
    data = env.rollout(12, break_when_any_done=False)
    action = data[keys.PREVIOUS_ACTION].squeeze(-1)
    reward = data[keys.PREVIOUS_REWARD].squeeze(-1)
    for row, length in enumerate(LENGTHS):
        starts = torch.arange(12) % length == 0
        assert (action[row, starts] == NONE).all()
        assert (reward[row, starts] == 0).all()
        later = (~starts).nonzero().squeeze(-1)
        assert torch.equal(action[row, later], data["action"][row, later - 1])
        assert (reward[row, later] == 0.5).all()
