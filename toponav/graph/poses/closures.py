"""Pairs of views that show the same place: what joins walks with each other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from toponav.graph.headings import agreed_angle, look_alike
from toponav.graph.waypoints import Compare, Embed

#: Views compared with their shortlists in one call.
_CHUNK = 256
#: Most votes for the direction of a walk, and sweeps over all walks.
_VOTES, _SWEEPS = 512, 3


@dataclass(frozen=True)
class Closures:
    """C pairs of views: their numbers, int64 ``[C]``, and similarities ``[C]``."""

    one: NDArray[np.int64]
    other: NDArray[np.int64]
    similarity: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.one)

    def only(self, kept: NDArray[np.bool_]) -> "Closures":
        """Those that are marked, ``[C]``."""
        return Closures(self.one[kept], self.other[kept], self.similarity[kept])


@torch.no_grad()
def find_closures(
    embeddings: Tensor,
    compare: Compare,
    prepare: Embed,
    *,
    above: float,
    shortlist: int = 64,
) -> Closures:
    """Pairs among V views whose similarity is ``above``, each once.

    Each of ``embeddings`` ``[V, D]`` is compared with as many as the ``shortlist``
    says, those whose embeddings have the smallest angle to it.
    """
    num = len(embeddings)
    directions, memory = F.normalize(embeddings, dim=-1), prepare(embeddings)
    found = []
    for start in range(0, num, _CHUNK):
        rows = slice(start, start + _CHUNK)
        angles = directions[rows] @ directions.T
        others = angles.topk(min(shortlist, num), -1).indices
        similarity = compare(embeddings[rows], memory[others]).float()
        row, column = (similarity > above).nonzero(as_tuple=True)
        found.append((row + start, others[row, column], similarity[row, column]))
    one, other, similarity = (torch.cat(part).numpy() for part in zip(*found))
    # A pair may be found from both of its ends.
    low, high = np.minimum(one, other), np.maximum(one, other)
    _, first = np.unique(low * num + high, return_index=True)
    first = first[low[first] != high[first]]
    return Closures(low[first], high[first], similarity[first])


def find_directions(
    headings: Tensor, walk: NDArray[np.int64], closures: Closures
) -> Tensor:
    """Degrees to add to the headings of each walk so that all count alike, ``[W]``.

    ``headings`` ``[V]`` are degrees of the views, seen from the first of their walk,
    and ``walk`` ``[V]`` their walks. Views of one place look the same way more often
    than any other, so that closures vote. A walk without enough votes that agree gets
    NaN; the one with most closures gets 0.
    """
    num = int(walk.max()) + 1
    one, other = torch.from_numpy(closures.one), torch.from_numpy(closures.other)
    turned = headings[one] - headings[other]
    ends = torch.from_numpy(np.stack([walk[closures.one], walk[closures.other]]))
    across = ends[0] != ends[1]
    ends, turned = ends[:, across], turned[across]
    offset = torch.full((num,), torch.nan)
    known = torch.zeros(num, dtype=torch.bool)
    first = int(torch.bincount(ends.flatten(), minlength=num).argmax())
    offset[first], known[first] = 0.0, True

    def vote(which: int) -> float | None:
        # What the other end of each closure says: heading + offset are equal.
        mine = (ends[0] == which) & known[ends[1]]
        theirs = (ends[1] == which) & known[ends[0]]
        votes = torch.cat(
            [
                offset[ends[1][mine]] - turned[mine],
                offset[ends[0][theirs]] + turned[theirs],
            ]
        )
        step = max(1, len(votes) // _VOTES)
        return agreed_angle(votes[::step])

    tried = True
    while tried:
        tried = False
        pairs = known[ends]
        half = pairs[0] ^ pairs[1]
        waiting = torch.where(pairs[0], ends[1], ends[0])[half]
        counts = torch.bincount(waiting, minlength=num)
        for which in counts.argsort(descending=True).tolist():
            if not counts[which]:
                break
            if (angle := vote(which)) is not None:
                offset[which], known[which], tried = angle, True, True
                break
    for _ in range(_SWEEPS):
        for which in known.nonzero().flatten().tolist():
            if which != first and (angle := vote(which)) is not None:
                offset[which] = angle
    return offset


def drop_turned(closures: Closures, headings: Tensor, tolerance: float) -> Closures:
    """Those whose views look the same way, up to ``tolerance`` degrees.

    A heading that is not known, NaN, is like none.
    """
    one, other = headings[closures.one], headings[closures.other]
    alike = look_alike(one, other, tolerance) & ~one.isnan() & ~other.isnan()
    return closures.only(alike.numpy())


def spread_weights(closures: Closures, num_views: int) -> NDArray[np.float64]:
    """A weight for each, smaller where its views have many: they say the same."""
    ends = np.concatenate([closures.one, closures.other])
    count = np.bincount(ends, minlength=num_views).astype(float)
    weights: NDArray[np.float64] = 1 / np.sqrt(
        count[closures.one] * count[closures.other]
    )
    return weights


def follows(walks: Sequence[int]) -> NDArray[np.int64]:
    """The walk of each view, int64 ``[V]``, by the lengths of the walks."""
    return np.repeat(np.arange(len(walks)), walks)
