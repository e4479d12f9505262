"""`BonusReward`: what transforms that pay by a model have in common."""

import torch
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import Transform

from toponav.keys import INTRINSIC_REWARD


class BonusReward(Transform):
    """Writes the intrinsic reward of each decision, float32 ``[*B, 1]``, in `_step`."""

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        spec = Unbounded((*reward_spec.shape, 1), reward_spec.device, torch.float32)
        return reward_spec.set(INTRINSIC_REWARD, spec)
