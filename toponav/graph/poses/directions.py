"""`find_directions`: how the headings of walks belong together."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toponav.graph.headings import agreed_angle
from toponav.graph.poses.closures import Closures

#: Most votes for the direction of a walk, the share of them that must agree (a ninth
#: would by chance), and sweeps over all walks.
_VOTES, _SHARE, _SWEEPS = 512, 0.3, 3


def find_directions(
    headings: Tensor, walk_of: NDArray[np.int64], closures: Closures
) -> Tensor:
    """Degrees to add to the headings of each walk so that all count alike, ``[W]``.

    Views of one place look the same way more often than any other, so that closures
    vote. The walk with most closures gets 0; then, one by one, the walk with most
    closures to those that have a direction. One without enough votes that agree gets
    NaN.

    Args:
        headings: degrees of the V views, seen from the first of their walk, ``[V]``.
        walk_of: the walk of each view, ``[V]``.
        closures: of the views.

    Examples:
        >>> walk_of = np.repeat([0, 1], 20)
        >>> same_place = Closures(np.arange(20), np.arange(20) + 20)
        >>> headings = torch.cat([torch.full((20,), 90.0), torch.zeros(20)])
        >>> find_directions(headings, walk_of, same_place).round().tolist()
        [0.0, 90.0]
    """
    votes = _Votes(headings, walk_of, closures)
    first = int(votes.count(torch.ones(votes.num, dtype=torch.bool)).argmax())
    offsets = torch.full((votes.num,), torch.nan, dtype=headings.dtype)
    offsets[first] = 0.0
    found = True
    while found:
        found = False
        counts = votes.count(offsets.isfinite()) * offsets.isnan()
        for walk in counts.argsort(descending=True).tolist():
            angle = votes.angle(walk, offsets) if counts[walk] else None
            if angle is not None:
                offsets[walk], found = angle, True
                break
    for _ in range(_SWEEPS):
        for walk in offsets.isfinite().nonzero().flatten().tolist():
            angle = votes.angle(walk, offsets) if walk != first else None
            offsets[walk] = offsets[walk] if angle is None else angle
    return offsets


class _Votes:
    """What closures between walks say of the walks' directions."""

    def __init__(
        self, headings: Tensor, walk_of: NDArray[np.int64], closures: Closures
    ) -> None:
        self.num = int(walk_of.max()) + 1
        pairs = [torch.from_numpy(some) for some in (closures.one, closures.other)]
        walks = torch.from_numpy(walk_of)
        one, other = (walks[some] for some in pairs)
        turned = headings[pairs[0]] - headings[pairs[1]]
        # Each closure votes for either end.
        across = one != other
        self._walk = torch.cat([one[across], other[across]])
        self._other = torch.cat([other[across], one[across]])
        self._turned = torch.cat([turned[across], -turned[across]])

    def count(self, known: Tensor) -> Tensor:
        """Votes for each walk by those that are ``known``, ``[W]``."""
        return torch.bincount(self._walk[known[self._other]], minlength=self.num)

    def angle(self, walk: int, offsets: Tensor) -> float | None:
        """The offset that most votes for a walk agree on."""
        mine = self._walk == walk
        votes = offsets[self._other[mine]] - self._turned[mine]
        votes = votes[votes.isfinite()]
        return agreed_angle(votes[:: max(1, len(votes) // _VOTES)], share=_SHARE)
