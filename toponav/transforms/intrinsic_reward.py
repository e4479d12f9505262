"""`IntrinsicReward`: one reward out of both novelty rewards."""

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite
from torchrl.envs.transforms import Transform

from toponav.keys import BORN, COUNT_REWARD, INTRINSIC_REWARD, TEMPORAL_DISTANCE_REWARD
from toponav.transforms.count_reward import CountReward
from toponav.transforms.novelty import Combine, check_combine, combine_rewards
from toponav.transforms.reward_keys import check_num_keys, declare_reward
from toponav.transforms.temporal_distance_reward import TemporalDistanceReward


class IntrinsicReward(Transform):
    """What an explorer learns from: count and temporal-distance reward (eq. 8).

    The two parts leave out what the other one pays, unless ``combine="sum"`` says
    that both always pay. So the parts always add up to this reward, and their returns
    can be logged apart. Give all three the same ``combine``.

    The reward has a key of its own; ``reward`` is untouched: point a loss at it with
    ``set_keys(reward="intrinsic_reward")``. Stateless.

    Reference:
        The paper, "Formulate reward function", eq. 8.

    Args:
        combine: ``"exclusive"`` or ``"sum"``, see `combine_rewards`.
        in_keys: keys of the two rewards, float32 ``[*B, 1]``, and of what pays as a
            new place, bool ``[*B, 1]``; ``count_reward``, ``temporal_distance_reward``
            and ``born`` unless given.
        out_keys: key of the reward, float32 ``[*B, 1]``.

    Raises:
        ValueError: if an argument is out of range, and when the env's specs are read,
            if a key is missing or a part has another ``combine``.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> data = TensorDict(
        ...     {
        ...         "count_reward": torch.tensor([[0.1], [0.0]]),
        ...         "temporal_distance_reward": torch.tensor([[0.0], [1.6]]),
        ...         "born": torch.tensor([[False], [True]]),
        ...     },
        ...     [2],
        ... )
        >>> IntrinsicReward()(data)["intrinsic_reward"].squeeze(-1)
        tensor([0.1000, 1.6000])

    Shape notation:
        B: batch of environments.
    """

    def __init__(
        self,
        combine: Combine = "exclusive",
        *,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        check_combine(combine)
        parts = [COUNT_REWARD, TEMPORAL_DISTANCE_REWARD, BORN]
        super().__init__(
            in_keys=parts if in_keys is None else in_keys,
            out_keys=[INTRINSIC_REWARD] if out_keys is None else out_keys,
        )
        check_num_keys(self, 3)
        self.combine = combine

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        count, temporal_distance, new = (
            next_tensordict.get(key) for key in self.in_keys
        )
        reward = combine_rewards(count, temporal_distance, new, self.combine)
        return next_tensordict.set(self.out_keys[0], reward)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict)

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        for part in getattr(self.parent, "transform", ()) or ():
            if not isinstance(part, CountReward | TemporalDistanceReward):
                continue
            if part.out_keys[0] in self.in_keys and part.combine != self.combine:
                raise ValueError(
                    f"combine must be that of {type(part).__name__}, "
                    f"{part.combine!r}, got {self.combine!r}"
                )
        return declare_reward(self, output_spec)
