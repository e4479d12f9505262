"""Pairs of views that show the same place: what joins walks with each other."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from toponav.graph.headings import look_alike
from toponav.graph.waypoints import Compare, Embed

#: Views compared with their shortlists in one call.
_CHUNK = 256


@dataclass(frozen=True)
class Closures:
    """C pairs of views that show one place, by their numbers, int64 ``[C]``."""

    one: NDArray[np.int64]
    other: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.one)

    def only(self, kept: NDArray[np.bool_]) -> "Closures":
        """Those that are marked, ``[C]``."""
        return Closures(self.one[kept], self.other[kept])


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
    parts = []
    for start in range(0, num, _CHUNK):
        rows = slice(start, start + _CHUNK)
        angles = directions[rows] @ directions.T
        others = angles.topk(min(shortlist, num), -1).indices
        found = compare(embeddings[rows], memory[others]).float()
        row, column = (found > above).nonzero(as_tuple=True)
        parts.append(torch.stack([row + start, others[row, column]]))
    one, other = torch.cat(parts, 1).numpy()
    # A pair may be found from both of its ends.
    low, high = np.minimum(one, other), np.maximum(one, other)
    _, first = np.unique(low * num + high, return_index=True)
    first = first[low[first] != high[first]]
    return Closures(low[first], high[first])


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
