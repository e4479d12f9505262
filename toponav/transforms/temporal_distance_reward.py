"""`TemporalDistanceReward`: pays for a view of a new place, the more the farther."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite
from torchrl.envs.transforms import Transform

from toponav.keys import BORN, SIMILARITY, TEMPORAL_DISTANCE_REWARD
from toponav.transforms.novelty import (
    Combine,
    check_combine,
    temporal_distance_reward,
)
from toponav.transforms.reward_keys import check_num_keys, declare_reward


class TemporalDistanceReward(Transform):
    """Pays ``beta / similarity`` to the nearest waypoint for a new place (eq. 7).

    A new place is a view that becomes a waypoint in this decision. So every payment
    makes its own view known, and an agent cannot be paid for staying. Without guards
    in `WaypointMemory` these are all views that are mapped to no waypoint, as in the
    paper; with them, give ``novel`` in place of ``born`` to pay while a view waits for
    its birth. ``combine="sum"`` pays in every decision, in known places too.

    The reward has a key of its own; ``reward`` is untouched. Stateless. Useful in any
    TorchRL project whose env writes a similarity:

    Reference:
        The paper, "Formulate reward function", eqs. 7 and 8.

    Args:
        beta: what a wholly similar view pays, at least 0.
        floor: the least similarity reckoned with, in (0, 1]; no view pays more than
            ``beta / floor``.
        clip: the most that a view pays; ``None`` for no further bound.
        combine: ``"exclusive"`` or ``"sum"``, see `combine_rewards`.
        in_keys: keys of the similarity, float32 ``[*B, 1]`` in [0, 1], and of what
            pays as a new place, bool ``[*B, 1]``; ``similarity`` and ``born`` unless
            given.
        out_keys: key of the reward, float32 ``[*B, 1]``.

    Raises:
        ValueError: if an argument is out of range, and when the env's specs are read,
            if a key is missing.

    Examples:
        >>> from tensordict import TensorDict
        >>> similarity = torch.tensor([[0.5], [0.01], [0.9]])
        >>> born = torch.tensor([[True], [True], [False]])
        >>> data = TensorDict({"similarity": similarity, "born": born}, [3])
        >>> reward = TemporalDistanceReward(beta=0.8)
        >>> reward(data)["temporal_distance_reward"].squeeze(-1)
        tensor([ 1.6000, 16.0000,  0.0000])

    Shape notation:
        B: batch of environments.
    """

    def __init__(
        self,
        beta: float,
        *,
        floor: float = 0.05,
        clip: float | None = None,
        combine: Combine = "exclusive",
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        check_combine(combine)
        temporal_distance_reward(torch.zeros(0), beta, floor=floor, clip=clip)
        super().__init__(
            in_keys=[SIMILARITY, BORN] if in_keys is None else in_keys,
            out_keys=[TEMPORAL_DISTANCE_REWARD] if out_keys is None else out_keys,
        )
        check_num_keys(self, 2)
        self.beta = beta
        self.floor = floor
        self.clip = clip
        self.combine = combine

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        similarity, new = (next_tensordict.get(key) for key in self.in_keys)
        reward = temporal_distance_reward(
            similarity, self.beta, floor=self.floor, clip=self.clip
        )
        if self.combine == "exclusive":
            reward = reward.masked_fill(~new, 0.0)
        return next_tensordict.set(self.out_keys[0], reward)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict)

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        return declare_reward(self, output_spec)
