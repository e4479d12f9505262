"""`CountReward`: pays for a view of a known place, the less the better known."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite
from torchrl.envs.transforms import Transform

from toponav.keys import BORN, COUNT_REWARD, VISITS
from toponav.transforms.novelty import Combine, check_combine, count_reward
from toponav.transforms.reward_keys import check_num_keys, declare_reward


class CountReward(Transform):
    """Pays ``alpha / sqrt(n)`` for the n-th visit of a waypoint (eq. 6).

    A decision that counts as no visit pays 0. A birth is the first visit of its own
    waypoint, but is paid by `TemporalDistanceReward` instead; with ``combine="sum"``
    it pays alpha here as well.

    The reward has a key of its own; ``reward`` is untouched. Stateless. Useful in any
    TorchRL project whose env counts visits:

    Reference:
        The paper, "Formulate reward function", eqs. 6 and 8.

    Args:
        alpha: what a first visit pays, at least 0.
        combine: ``"exclusive"`` or ``"sum"``, see `combine_rewards`.
        in_keys: keys of the visits, int64 ``[*B, 1]``, and of what pays as a new
            place, bool ``[*B, 1]``; ``visits`` and ``born`` unless given.
        out_keys: key of the reward, float32 ``[*B, 1]``.

    Raises:
        ValueError: if an argument is out of range, and when the env's specs are read,
            if a key is missing.

    Examples:
        >>> from tensordict import TensorDict
        >>> visits = torch.tensor([[1], [4], [0]])
        >>> born = torch.tensor([[True], [False], [False]])
        >>> data = TensorDict({"visits": visits, "born": born}, [3])
        >>> CountReward(alpha=0.2)(data)["count_reward"].squeeze(-1)
        tensor([0.0000, 0.1000, 0.0000])

    Shape notation:
        B: batch of environments.
    """

    def __init__(
        self,
        alpha: float,
        *,
        combine: Combine = "exclusive",
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        check_combine(combine)
        count_reward(torch.zeros(0, dtype=torch.int64), alpha)
        super().__init__(
            in_keys=[VISITS, BORN] if in_keys is None else in_keys,
            out_keys=[COUNT_REWARD] if out_keys is None else out_keys,
        )
        check_num_keys(self, 2)
        self.alpha = alpha
        self.combine = combine

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        reward = count_reward(next_tensordict.get(self.in_keys[0]), self.alpha)
        if self.combine == "exclusive":
            reward = reward.masked_fill(next_tensordict.get(self.in_keys[1]), 0.0)
        return next_tensordict.set(self.out_keys[0], reward)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict)

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        return declare_reward(self, output_spec)
