"""The novelty rewards as free functions on plain tensors.

- `aggregate_similarity`: one similarity out of those to all waypoints.
- `count_reward`: eq. 6, for a view of a known place.
- `temporal_distance_reward`: eq. 7, for a view of a new place.
- `combine_rewards`: eq. 8, one reward out of both.

Reference:
    "A target-driven visual navigation method based on intrinsic motivation
    exploration and space topological cognition", "Formulate reward function".
"""

from typing import Literal, get_args

import torch
from torch import Tensor

#: ``"max"`` is the nearest waypoint (the paper's), a number a percentile.
Aggregate = Literal["max"] | float
#: How the two rewards make one: see `combine_rewards`.
Combine = Literal["exclusive", "sum"]


def check_aggregate(aggregate: Aggregate) -> None:
    """Refuse an ``aggregate`` that is neither ``"max"`` nor a percentile.

    Raises:
        ValueError: as said.
    """
    known = aggregate == "max" if isinstance(aggregate, str) else 0 <= aggregate <= 100
    if not known:
        raise ValueError(
            f"aggregate must be 'max' or a percentile in [0, 100], got {aggregate!r}"
        )


def check_combine(combine: Combine) -> None:
    """Refuse a ``combine`` that is no way to read eq. 8.

    Raises:
        ValueError: as said.
    """
    if combine not in get_args(Combine):
        raise ValueError(f"combine must be one of {get_args(Combine)}, got {combine!r}")


def aggregate_similarity(
    similarity: Tensor, live: Tensor, aggregate: Aggregate = "max"
) -> Tensor:
    """Similarity of a view to a memory, out of those to its waypoints.

    The maximum is the paper's. It is taken over many noisy numbers, so a percentile
    is less easily fooled by one false match; but a place seen once is one waypoint
    among hundreds, which a percentile overlooks.

    Args:
        similarity: float ``[*B, M]`` in [0, 1].
        live: bool ``[*B, M]``; which slots hold a waypoint. The others are not read.
        aggregate: ``"max"`` or a percentile in [0, 100], interpolated linearly.

    Returns:
        ``[*B]``; 0 where no slot is live.

    Raises:
        ValueError: if ``aggregate`` is neither.

    Examples:
        >>> similarity = torch.tensor([[0.2, 0.6, 0.4, 0.9]])
        >>> live = torch.tensor([[True, True, True, False]])
        >>> aggregate_similarity(similarity, live)
        tensor([0.6000])
        >>> aggregate_similarity(similarity, live, 75)  # halfway from 0.4 to 0.6
        tensor([0.5000])

    Shape notation:
        B: any batch dimensions.  M: memory.
    """
    check_aggregate(aggregate)
    if similarity.shape[-1] == 0:
        return similarity.new_zeros(similarity.shape[:-1])
    if aggregate == "max":
        return similarity.masked_fill(~live, 0.0).amax(-1)
    known = similarity.masked_fill(~live, torch.nan)
    found = known.nanquantile(float(aggregate) / 100, dim=-1)
    return torch.where(live.any(-1), found, 0.0)


def count_reward(visits: Tensor, alpha: float) -> Tensor:
    """Pay ``alpha / sqrt(n)`` for the n-th visit of a waypoint (eq. 6).

    Args:
        visits: int ``[*B]``; n, this visit included. 0 for no visit, which pays 0.
        alpha: what the first visit pays.

    Returns:
        float32 ``[*B]``.

    Raises:
        ValueError: if ``alpha`` is negative.

    Examples:
        >>> count_reward(torch.tensor([0, 1, 4]), alpha=0.2)
        tensor([0.0000, 0.2000, 0.1000])

    Shape notation:
        B: any batch dimensions.
    """
    if not alpha >= 0:
        raise ValueError(f"alpha must be at least 0, got {alpha}")
    return (alpha * visits.clamp(min=1).rsqrt()).masked_fill(visits == 0, 0.0)


def temporal_distance_reward(
    similarity: Tensor, beta: float, *, floor: float = 0.05, clip: float | None = None
) -> Tensor:
    """Pay ``beta / similarity`` to the nearest waypoint (eq. 7).

    The paper's minimum over waypoints of a reciprocal is the reciprocal of the
    maximum. It has no bound; ``floor`` gives it one.

    Args:
        similarity: float ``[*B]`` in [0, 1].
        beta: what a view pays that is wholly similar.
        floor: the least similarity reckoned with, so that no view pays more than
            ``beta / floor``.
        clip: the most that a view pays; ``None`` for no further bound.

    Returns:
        float ``[*B]``, from ``beta`` on.

    Raises:
        ValueError: if ``beta`` is negative, ``floor`` not in (0, 1] or ``clip`` not
            above 0.

    Examples:
        >>> similarity = torch.tensor([0.5, 0.1, 0.0])
        >>> temporal_distance_reward(similarity, beta=0.8)
        tensor([ 1.6000,  8.0000, 16.0000])
        >>> temporal_distance_reward(similarity, beta=0.8, clip=2.0)
        tensor([1.6000, 2.0000, 2.0000])

    Shape notation:
        B: any batch dimensions.
    """
    if not beta >= 0:
        raise ValueError(f"beta must be at least 0, got {beta}")
    if not 0 < floor <= 1:
        raise ValueError(f"floor must be in (0, 1], got {floor}")
    if clip is not None and not clip > 0:
        raise ValueError(f"clip must be above 0, got {clip}")
    reward = beta / similarity.clamp(min=floor)
    return reward if clip is None else reward.clamp(max=clip)


def combine_rewards(
    count: Tensor,
    temporal_distance: Tensor,
    novel: Tensor,
    how: Combine = "exclusive",
) -> Tensor:
    """One reward out of both (eq. 8).

    The equation adds the two, while the text pays the first if the view is mapped to
    a waypoint and the second if not. ``"exclusive"`` is the text; ``"sum"``, the
    equation by the letter, pays at least beta in every decision.

    Args:
        count: ``[*B]``, eq. 6.
        temporal_distance: ``[*B]``, eq. 7.
        novel: bool ``[*B]``; the view is paid as a new place.
        how: ``"exclusive"`` or ``"sum"``.

    Returns:
        ``[*B]``.

    Raises:
        ValueError: if ``how`` is neither.

    Examples:
        >>> count, distance = torch.tensor([0.2, 0.2]), torch.tensor([1.6, 0.9])
        >>> novel = torch.tensor([True, False])
        >>> combine_rewards(count, distance, novel)
        tensor([1.6000, 0.2000])
        >>> combine_rewards(count, distance, novel, how="sum")
        tensor([1.8000, 1.1000])

    Shape notation:
        B: any batch dimensions.
    """
    check_combine(how)
    if how == "sum":
        return count + temporal_distance
    return torch.where(novel, temporal_distance, count)
