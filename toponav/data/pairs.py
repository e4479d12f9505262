"""What `TCPairs` and `LPairs` share: drawing, weighing, gathering."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from toponav.data.episodes import Episodes
from toponav.keys import ANCHOR, EMBEDDING, EPISODE, OTHER, STEP


def compare_steps(frames: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Of F frames ``[F, F]``: same episode or not, and decisions from row to column."""
    episode = frames.get(EPISODE).flatten().cpu()
    step = frames.get(STEP).flatten().cpu()
    same = episode.unsqueeze(0) == episode.unsqueeze(1)
    return same, step.unsqueeze(0) - step.unsqueeze(1)


def distance_weights(distance: Tensor, max_distance: int) -> Tensor:
    """Weights that make every distance that occurs count the same; they sum to one."""
    count = torch.bincount(distance, minlength=max_distance + 1)
    return 1 / (count[distance] * (count > 0).sum().clamp(min=1)).float()


def gather_pairs(
    frames: TensorDictBase, pair: Tensor, entries: dict[str, Tensor]
) -> TensorDict:
    """Embeddings of the pairs ``[P, 2]``, numbers of flattened frames, and entries."""
    views = frames.get(EMBEDDING).flatten(0, frames.ndim - 1)
    anchor, other = pair.to(views.device).unbind(-1)
    entries = {ANCHOR: views[anchor], OTHER: views[other], **entries}
    moved = {key: entry.to(views.device) for key, entry in entries.items()}
    return TensorDict(moved, [len(pair)])


def draw_near(
    episodes: Episodes, num: int, k: int, generator: torch.Generator | None
) -> Tensor:
    """Places ``[num, 2]`` of pairs, evenly 1..k decisions apart, the earlier first."""
    distance = 1 + draw_below(torch.full((num,), k), generator)
    # A run of length L has L - j frames that have a partner j decisions later.
    room = (episodes.length.unsqueeze(-1) - distance).clamp(min=0)
    before = room.cumsum(0)
    target = draw_below(before[-1], generator)
    run = (before <= target).sum(0)
    offset = target - (before - room)[run, torch.arange(num)]
    anchor = episodes.start[run] + offset
    return torch.stack([anchor, anchor + distance], dim=-1)


def draw_below(limit: Tensor, generator: torch.Generator | None) -> Tensor:
    """Uniform integers in ``[0, limit)``, elementwise; every limit is at least 1."""
    uniform = torch.rand(limit.shape, dtype=torch.float64, generator=generator)
    return (uniform * limit).long()
