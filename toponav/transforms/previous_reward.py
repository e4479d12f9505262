"""`PreviousReward`: lets a policy see what it was paid before."""

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torchrl.data import Bounded, Composite
from torchrl.envs.transforms import Transform

from toponav.keys import INTRINSIC_REWARD, PREVIOUS_REWARD
from toponav.transforms.reward_keys import check_num_keys


class PreviousReward(Transform):
    """Writes the reward that came with an observation, clipped; 0 after a reset.

    The clipping is for the policy's eyes: the reward itself is untouched. Stateless;
    for any TorchRL env, with ``in_keys=["reward"]`` for the task's reward.

    Reference:
        The paper, "Model implementation": the LSTM is fed the previous reward.

    Args:
        clip: rewards are cut to ``[-clip, clip]``.
        in_keys: key of the reward, float32 ``[*B, 1]``; ``intrinsic_reward`` unless
            given.
        out_keys: key of the reward before; ``previous_reward`` unless given.

    Raises:
        ValueError: if an argument is out of range, and when the env's specs are read,
            if it has no such reward.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> paid = TensorDict({"intrinsic_reward": torch.tensor([[0.2], [16.0]])}, [2])
        >>> PreviousReward()._step(TensorDict(), paid)["previous_reward"].squeeze(-1)
        tensor([0.2000, 1.0000])

    Shape notation:
        B: batch of environments.
    """

    def __init__(
        self,
        clip: float = 1.0,
        *,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        if not clip > 0:
            raise ValueError(f"clip must be above 0, got {clip}")
        super().__init__(
            in_keys=[INTRINSIC_REWARD] if in_keys is None else in_keys,
            out_keys=[PREVIOUS_REWARD] if out_keys is None else out_keys,
        )
        check_num_keys(self, 1)
        self.clip = clip

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        reward = next_tensordict.get(self.in_keys[0])
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
        rewards = self.parent.full_reward_spec
        key = self.in_keys[0]
        if key not in rewards.keys(True, True):
            raise ValueError(
                f"in_keys must be a reward of the env, got {key!r}; it has "
                f"{list(rewards.keys(True, True))}"
            )
        observation_spec[self.out_keys[0]] = Bounded(
            -self.clip,
            self.clip,
            shape=rewards[key].shape,
            dtype=rewards[key].dtype,
            device=rewards[key].device,
        )
        return observation_spec
