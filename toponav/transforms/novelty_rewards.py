"""The novelty rewards, as functions on tensors and as transforms, and a random one.

Reference:
    The paper, "Formulate reward function", eqs. 6 to 8.
"""

from collections.abc import Callable
from typing import Literal, get_args

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded

from toponav import keys
from toponav.keys import read_entry
from toponav.transforms.specs import (
    KeyedTransform,
    Keys,
    SeededMixin,
    find_spec,
)

#: When each reward pays. The text pays the first if the view is mapped to a waypoint,
#: else the second: ``"exclusive"``. ``"sum"`` is the literal equation, which pays
#: at least beta in every decision.
Combine = Literal["exclusive", "sum"]


def count_reward(visits: Tensor, alpha: float) -> Tensor:
    """``alpha / sqrt(visits)`` (eq. 6), float32; 0 for 0 visits.

    Examples:
        >>> count_reward(torch.tensor([0, 1, 4]), alpha=0.2)
        tensor([0.0000, 0.2000, 0.1000])
    """
    if not alpha >= 0:
        raise ValueError(f"alpha must be at least 0, got {alpha}")
    return (alpha * visits.clamp(min=1).rsqrt()).masked_fill(visits == 0, 0.0)


def temporal_distance_reward(
    similarity: Tensor, beta: float, *, floor: float = 0.05
) -> Tensor:
    """``beta / similarity`` to the nearest waypoint (eq. 7), at most ``beta / floor``.

    Examples:
        >>> temporal_distance_reward(torch.tensor([0.5, 0.1, 0.0]), beta=0.8)
        tensor([ 1.6000,  8.0000, 16.0000])
    """
    if not beta >= 0:
        raise ValueError(f"beta must be at least 0, got {beta}")
    if not 0 < floor <= 1:
        raise ValueError(f"floor must be in (0, 1], got {floor}")
    return beta / similarity.clamp(min=floor)


def _check_combine(combine: str) -> None:
    if combine not in get_args(Combine):
        raise ValueError(f"combine must be one of {get_args(Combine)}, got {combine!r}")


class _NoveltyReward(KeyedTransform):
    #: The reward, of the entries of ``in_keys``.
    _pay: Callable[..., Tensor]

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        entries = (read_entry(next_tensordict, key) for key in self.in_keys)
        return next_tensordict.set(self.out_keys[0], self._pay(*entries))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict)

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        # Asking `parent` for specs would compute those of all earlier transforms again.
        output_spec = output_spec.clone()
        rewards = output_spec["full_reward_spec"]
        known, kind = rewards.clone(), "an observation or a reward"
        known.update(output_spec["full_observation_spec"])
        like, *_ = [find_spec(known, key, kind=kind) for key in self.in_keys]
        rewards[self.out_keys[0]] = Unbounded(like.shape, like.device, torch.float32)
        return output_spec


class CountReward(_NoveltyReward):
    """Pays ``alpha / sqrt(n)`` for the n-th visit of a waypoint (eq. 6).

    For a new waypoint `TemporalDistanceReward` pays instead; with ``combine="sum"``
    both.

    Args:
        alpha: what a first visit pays, at least 0.
        combine: ``"exclusive"`` or ``"sum"``, see `Combine`.
        in_keys: keys of the visits, int64 ``[*B, 1]``, 0 where nothing is paid, and of
            what pays as a new place, bool ``[*B, 1]``.
        out_keys: key of the reward, float32 ``[*B, 1]``.

    Examples:
        >>> decisions = {"visits": torch.tensor([[1], [4], [1]])}  # the last is new
        >>> decisions["is_new_waypoint"] = torch.tensor([[False], [False], [True]])
        >>> CountReward(0.2)(TensorDict(decisions, [3]))["count_reward"].squeeze(-1)
        tensor([0.2000, 0.1000, 0.0000])
    """

    default_keys = [keys.VISITS, keys.IS_NEW_WAYPOINT], [keys.COUNT_REWARD]

    def __init__(
        self,
        alpha: float,
        *,
        combine: Combine = "exclusive",
        in_keys: Keys = None,
        out_keys: Keys = None,
    ) -> None:
        count_reward(torch.zeros(0, dtype=torch.int64), alpha)
        _check_combine(combine)
        super().__init__(in_keys, out_keys)
        self.combine = combine
        self.alpha = alpha

    def _pay(self, visits: Tensor, is_new: Tensor) -> Tensor:
        reward = count_reward(visits, self.alpha)
        return reward if self.combine == "sum" else reward.masked_fill(is_new, 0.0)


class TemporalDistanceReward(_NoveltyReward):
    """Pays ``beta / similarity`` to the nearest waypoint for a new one (eq. 7).

    Each payment makes its own view known: an agent cannot be paid for staying. The
    paper pays for every view that is mapped to no waypoint: give ``novel`` in place of
    ``is_new_waypoint`` for that.

    Args:
        beta: what a view of similarity 1 pays, at least 0.
        floor: least similarity, in (0, 1]; no view pays more than ``beta / floor``.
        combine: ``"exclusive"`` or ``"sum"``, see `Combine`.
        in_keys: keys of the similarity, float32 ``[*B, 1]`` in [0, 1], and of what pays
            as a new place, bool ``[*B, 1]``.
        out_keys: key of the reward, float32 ``[*B, 1]``.

    Examples:
        >>> decisions = {"similarity": torch.tensor([[0.5], [0.01], [0.9]])}
        >>> decisions["is_new_waypoint"] = torch.tensor([[True], [True], [False]])
        >>> rewarded = TemporalDistanceReward(0.8)(TensorDict(decisions, [3]))
        >>> rewarded["temporal_distance_reward"].squeeze(-1)  # 0.01 counts as 0.05
        tensor([ 1.6000, 16.0000,  0.0000])
    """

    default_keys = (
        [keys.SIMILARITY, keys.IS_NEW_WAYPOINT],
        [keys.TEMPORAL_DISTANCE_REWARD],
    )

    def __init__(
        self,
        beta: float,
        *,
        floor: float = 0.05,
        combine: Combine = "exclusive",
        in_keys: Keys = None,
        out_keys: Keys = None,
    ) -> None:
        temporal_distance_reward(torch.zeros(0), beta, floor=floor)
        _check_combine(combine)
        super().__init__(in_keys, out_keys)
        self.combine = combine
        self.beta = beta
        self.floor = floor

    def _pay(self, similarity: Tensor, is_new: Tensor) -> Tensor:
        reward = temporal_distance_reward(similarity, self.beta, floor=self.floor)
        return reward if self.combine == "sum" else reward.masked_fill(~is_new, 0.0)


class IntrinsicReward(_NoveltyReward):
    """What an explorer learns from: count plus temporal-distance reward (eq. 8).

    Args:
        in_keys: keys of the two rewards, float32 ``[*B, 1]``.
        out_keys: key of the reward, float32 ``[*B, 1]``.

    Examples:
        >>> parts = {"count_reward": torch.tensor([[0.1], [0.0]])}
        >>> parts["temporal_distance_reward"] = torch.tensor([[0.0], [1.6]])
        >>> IntrinsicReward()(TensorDict(parts, [2]))["intrinsic_reward"].squeeze(-1)
        tensor([0.1000, 1.6000])
    """

    default_keys = (
        [keys.COUNT_REWARD, keys.TEMPORAL_DISTANCE_REWARD],
        [keys.INTRINSIC_REWARD],
    )

    def _pay(self, count: Tensor, temporal_distance: Tensor) -> Tensor:
        return count + temporal_distance


class RandomReward(SeededMixin, KeyedTransform):
    """Draws a reward from [0, 1) for each env and decision, as a control for learners.

    The same seed gives the same rewards on every device; workers need different ones.

    Args:
        seed: of the rewards; ``None`` takes one from the operating system.
        out_keys: key of the reward, float32 ``[*B, 1]``.

    Examples:
        >>> drawn = RandomReward(seed=0)._step(None, TensorDict(batch_size=[2]))
        >>> drawn["intrinsic_reward"].squeeze(-1)
        tensor([0.4963, 0.7682])
    """

    default_keys = [], [keys.INTRINSIC_REWARD]

    def __init__(self, seed: int | None = None, *, out_keys: Keys = None) -> None:
        super().__init__([], out_keys)
        self.set_seed(seed)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        drawn = torch.rand(*next_tensordict.batch_size, 1, generator=self.generator)
        drawn = drawn.to(next_tensordict.device, non_blocking=True)
        return next_tensordict.set(self.out_keys[0], drawn)

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        shape, device = (*reward_spec.shape, 1), reward_spec.device
        spec = Bounded(0.0, 1.0, shape, device, torch.float32)
        return reward_spec.set(self.out_keys[0], spec)
