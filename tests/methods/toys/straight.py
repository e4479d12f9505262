"""A toy reward method, as docs/extending.md has it."""

from dataclasses import dataclass

from tensordict import TensorDictBase
from torchrl.data import Unbounded
from torchrl.envs.transforms import Transform

from toponav.builders import RewardMethod
from toponav.config import RewardConfig, above


class StraightReward(Transform):
    """Pays for action 0."""

    def __init__(self, amount: float) -> None:
        super().__init__(in_keys=["action"], out_keys=["straight_reward"])
        self.amount = amount

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        straight = (tensordict["action"] == 0).float().unsqueeze(-1)
        return next_tensordict.set("straight_reward", self.amount * straight)

    def transform_reward_spec(self, reward_spec):
        reward_spec["straight_reward"] = Unbounded((*self.parent.batch_size, 1))
        return reward_spec


@dataclass
class StraightConfig(RewardConfig):
    """Settings of ``reward=straight``."""

    amount: float = above(0)


class StraightMethod(RewardMethod):
    """Pays for walking straight on."""

    schema = StraightConfig
    reward_key = "straight_reward"

    def make_transforms(self, *, num_envs: int, seed: int) -> list[Transform]:
        return [StraightReward(self.config.amount)]
