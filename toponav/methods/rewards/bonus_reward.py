"""`BonusReward`: what transforms that pay by a model have in common."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import Transform

from toponav.keys import INTRINSIC_REWARD
from toponav.parts import needs_env
from toponav.transforms import SeesLastViews


class BonusReward(SeesLastViews, Transform):
    """Writes the intrinsic reward of each decision, float32 ``[*B, 1]``, in `_step`."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        raise needs_env(self)

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        spec = Unbounded((*reward_spec.shape, 1), reward_spec.device, torch.float32)
        return reward_spec.set(INTRINSIC_REWARD, spec)


def batch_of(observation: Tensor, shape: Sequence[int]) -> torch.Size:
    """The batch ``*B`` of observations ``[*B, *shape]``; ValueError for others."""
    batch = observation.shape[: observation.ndim - len(shape)]
    if observation.shape != (*batch, *shape):
        rule = f"observations must end in the shape {list(shape)}"
        raise ValueError(f"{rule}, got {list(observation.shape)}.")
    return batch
