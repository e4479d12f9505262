"""`PreviousReward`: lets a policy see what it was paid before."""

from tensordict import TensorDictBase
from torchrl.data import Bounded, Composite

from toponav.keys import INTRINSIC_REWARD, PREVIOUS_REWARD
from toponav.transforms.specs import KeyedTransform, Keys, find_spec, get_entry


class PreviousReward(KeyedTransform):
    """Writes the reward that came with an observation, clipped; 0 after a reset.

    Reference:
        The paper, "Model implementation": the LSTM is fed the previous reward.

    Args:
        clip: rewards are cut to ``[-clip, clip]``.
        in_keys: key of the reward, ``intrinsic_reward`` unless given.
        out_keys: key of the clipped one, ``previous_reward`` unless given.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> paid = TensorDict({"intrinsic_reward": torch.tensor([[0.2], [16.0]])}, [2])
        >>> PreviousReward()._step(TensorDict(), paid)["previous_reward"].squeeze(-1)
        tensor([0.2000, 1.0000])
    """

    def __init__(
        self, clip: float = 1.0, *, in_keys: Keys = None, out_keys: Keys = None
    ) -> None:
        if not clip > 0:
            raise ValueError(f"clip must be above 0, got {clip}")
        defaults = [INTRINSIC_REWARD], [PREVIOUS_REWARD]
        super().__init__(in_keys, out_keys, defaults=defaults)
        self.clip = clip

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        reward = get_entry(self, next_tensordict, self.in_keys[0])
        return next_tensordict.set(
            self.out_keys[0], reward.clamp(-self.clip, self.clip)
        )

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # Rows that go on keep what they had: TorchRL merges this by the mask.
        start = self.parent.full_reward_spec[self.in_keys[0]].zero()
        return tensordict_reset.set(self.out_keys[0], start)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        rewards, key = self.parent.full_reward_spec, self.in_keys[0]
        reward = find_spec(rewards, key, kind="a reward")
        bounds = -self.clip, self.clip
        observation_spec[self.out_keys[0]] = Bounded(
            *bounds, reward.shape, dtype=reward.dtype, device=reward.device
        )
        return observation_spec
