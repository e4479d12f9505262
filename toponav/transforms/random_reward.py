"""`RandomReward`: a reward that means nothing, as a control for learners."""

import torch
from tensordict import TensorDictBase
from torchrl.data import Bounded, Composite

from toponav.keys import INTRINSIC_REWARD
from toponav.transforms.specs import KeyedTransform, Keys, SeededMixin


class RandomReward(SeededMixin, KeyedTransform):
    """Draws a reward from [0, 1) for each env and decision, as a control for learners.

    The generator is on the CPU: the same seed gives the same rewards on every device.
    Copies in several workers need different seeds.

    Args:
        seed: of the rewards; ``None`` takes one from the operating system.
        out_keys: key of the reward, float32 ``[*B, 1]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> drawn = RandomReward(seed=0)._step(None, TensorDict(batch_size=[2]))
        >>> drawn["intrinsic_reward"].squeeze(-1)
        tensor([0.4963, 0.7682])
    """

    default_keys = [], [INTRINSIC_REWARD]

    def __init__(self, seed: int | None = None, *, out_keys: Keys = None) -> None:
        super().__init__([], out_keys)
        self.set_seed(seed)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        drawn = torch.rand(*next_tensordict.batch_size, 1, generator=self.generator)
        return next_tensordict.set(self.out_keys[0], drawn.to(next_tensordict.device))

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        shape, device = (*reward_spec.shape, 1), reward_spec.device
        reward_spec[self.out_keys[0]] = Bounded(0.0, 1.0, shape, device, torch.float32)
        return reward_spec
