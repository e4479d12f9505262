"""Does the most similar view show the same place?"""

import torch
from torch import Tensor


def pair_candidates(
    episode: Tensor, step: Tensor, *, min_gap: int, rows: Tensor | None = None
) -> Tensor:
    """Which views may stand for each other: of two episodes, or far apart in time.

    Args:
        episode: int64 ``[V]``.
        step: decision within the episode, int64 ``[V]``.
        min_gap: least number of decisions between two views of one episode; 1 for any.
        rows: int64 ``[Q]``, the views that look for others; all by default.

    Returns:
        bool ``[Q, V]``; never true for a view and itself.
    """
    if min_gap < 1:
        raise ValueError(f"min_gap must be at least 1, got {min_gap}.")
    rows = torch.arange(len(episode)) if rows is None else rows
    other = episode != episode[rows].unsqueeze(1)
    return other | ((step - step[rows].unsqueeze(1)).abs() >= min_gap)


def most_similar(similarity: Tensor, candidates: Tensor) -> Tensor:
    """Most similar of ``candidates`` ``[Q, V]``, int64 ``[Q]``; -1 without one."""
    best = similarity.masked_fill(~candidates, -torch.inf).argmax(1)
    return torch.where(candidates.any(1), best, -1)


def place_error(distance: Tensor, *, limit: float) -> float:
    """Share of views whose most similar other view is farther than ``limit``.

    A network can tell near from far pairs well and still be useless for localisation,
    where the maximum over many views decides: in our trials 84 % accuracy came with an
    error of 26 %. A NaN in ``distance`` ``[Q]`` is a view without candidates, left out.

    Examples:
        >>> place_error(torch.tensor([10.0, 256.0, 257.0, 999.0]), limit=256.0)
        0.5
    """
    return float((distance[~distance.isnan()] > limit).double().mean())
