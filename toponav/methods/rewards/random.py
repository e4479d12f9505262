"""Random rewards: a control for learners."""

from torchrl.envs.transforms import Transform

from toponav.builders import RewardMethod
from toponav.keys import INTRINSIC_REWARD
from toponav.transforms import RandomReward


class RandomMethod(RewardMethod):
    """A random number in [0, 1) in each decision: what a learner makes of no reward."""

    selection_metric = None
    reward_key = INTRINSIC_REWARD

    def make_transforms(self, *, num_envs: int, seed: int) -> list[Transform]:
        return [RandomReward(seed=seed)]
