"""The arithmetic that `TCPairs` and `LPairs` share: drawing, weighing, gathering."""

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor

from toponav.data.episodes import Episodes
from toponav.keys import ANCHOR, OTHER


def distance_weights(distance: Tensor, max_distance: int) -> Tensor:
    """Weights that make every distance that occurs count the same; they sum to one.

    Args:
        distance: int64 ``[P]``, in 1..``max_distance``.
        max_distance: the largest distance.

    Examples:
        >>> distance_weights(torch.tensor([1, 1, 2]), 4)
        tensor([0.2500, 0.2500, 0.5000])
    """
    count = torch.bincount(distance, minlength=max_distance + 1)
    return 1 / (count[distance] * (count > 0).sum().clamp(min=1)).float()


def gather_pairs(
    frames: TensorDictBase,
    pair: Tensor,
    in_key: NestedKey,
    entries: dict[str, Tensor],
) -> TensorDict:
    """A tensordict of pairs from frames and the two frames' numbers.

    Args:
        frames: ``[*B]`` with ``in_key``.
        pair: int64 ``[P, 2]``, numbers of flattened frames.
        in_key: what becomes ``anchor`` and ``other``.
        entries: more entries, each ``[P]``.

    Returns:
        ``[P]``, on the device of the frames.
    """
    views = frames.get(in_key).flatten(0, frames.ndim - 1)
    anchor, other = pair.to(views.device).unbind(-1)
    pairs = TensorDict({ANCHOR: views[anchor], OTHER: views[other]}, [len(pair)])
    for key, entry in entries.items():
        pairs.set(key, entry.to(views.device))
    return pairs


def draw_at_distance(
    episodes: Episodes, distance: Tensor, generator: torch.Generator | None
) -> Tensor:
    """Draw pairs of given distances, uniform over the frames that have such a partner.

    Args:
        episodes: the runs to draw from; one must be longer than every distance.
        distance: int64 ``[P]``, in decisions.
        generator: source of the random numbers, torch's own by default.

    Returns:
        Places ``[P, 2]`` of the earlier and the later frame.
    """
    # A run of length L has L - j frames that have a partner j decisions later.
    room = (episodes.length.unsqueeze(-1) - distance).clamp(min=0)
    before = room.cumsum(0)
    target = draw_below(before[-1], generator)
    run = (before <= target).sum(0)
    column = torch.arange(len(distance))
    offset = target - (before - room)[run, column]
    anchor = episodes.start[run] + offset
    return torch.stack([anchor, anchor + distance], dim=-1)


def draw_below(limit: Tensor, generator: torch.Generator | None) -> Tensor:
    """Uniform integers in ``[0, limit)``, elementwise.

    Args:
        limit: int64, of any shape, at least 1 everywhere.
        generator: source of the random numbers, torch's own by default.
    """
    uniform = torch.rand(limit.shape, dtype=torch.float64, generator=generator)
    return (uniform * limit).long()
