"""`WalkedGround`: where agents have walked, and so where the ground is free."""

import torch
from torch import Tensor
from torch.nn.functional import conv2d

#: Spots before an agent: bearings to the left of where it looks, in degrees, and
#: distances in steps.
BEARINGS = torch.arange(-90.0, 91.0, 15.0)
DISTANCES = torch.arange(0.5, 6.1, 0.5)
#: Steps between the points of the grid, and around all that was walked.
_GRID, _AROUND = 0.25, 2.0


class WalkedGround:
    """A grid of how many of V views were taken around each point.

    Agents walk where no wall is. A point is free if there are at least ``least`` times
    as many views around it, by a bell curve, as around the median view: poses are not
    exact, so that a few of them lie inside walls.

    Args:
        positions: of the views, ``[V, 2]``, in steps.
        width: standard deviation of the bell curve, in steps.
        least: share of the median, in [0, 1].

    Examples:
        >>> corridor = torch.stack([torch.arange(0, 9, 0.1), torch.zeros(90)], 1)
        >>> ground = WalkedGround(corridor)
        >>> ground.is_free(torch.tensor([[4.0, 0.0], [4.0, 2.0], [99.0, 0.0]]))
        tensor([ True, False, False])
    """

    def __init__(
        self, positions: Tensor, *, width: float = 0.4, least: float = 0.25
    ) -> None:
        if not len(positions):
            raise ValueError("positions must be those of one view at least, got none")
        self.low = positions.amin(0) - _AROUND
        span = positions.amax(0) + _AROUND - self.low
        self.size = (span / _GRID).ceil().long() + 1
        at = self._number(positions)
        views = torch.bincount(at, minlength=int(self.size.prod())).float()
        reach = round(4 * width / _GRID)
        bell = torch.arange(-reach, reach + 1) * _GRID / width
        bell = (-0.5 * bell.square()).exp()
        grid = views.reshape(1, 1, *self.size.tolist())
        grid = conv2d(grid, bell.reshape(1, 1, -1, 1), padding=(reach, 0))
        grid = conv2d(grid, bell.reshape(1, 1, 1, -1), padding=(0, reach))
        around = grid.flatten()
        self._free = around >= least * around[at].median()

    def _number(self, points: Tensor) -> Tensor:
        cell = ((points - self.low) / _GRID).round().long()
        cell = cell.clamp(min=0).minimum(self.size - 1)
        return cell[..., 0] * self.size[1] + cell[..., 1]

    def is_free(self, points: Tensor) -> Tensor:
        """Whether the ground is free at ``points`` ``[*B, 2]``, bool ``[*B]``."""
        # The border of the grid, where all beyond it falls, was never walked.
        return self._free[self._number(points)]

    def before(self, poses: Tensor) -> Tensor:
        """`is_free` at `spots` before ``poses`` ``[*B, 3]``: bool ``[*B, K, R]``."""
        return self.is_free(spots(poses))


def spots(poses: Tensor) -> Tensor:
    """Points at K `BEARINGS` and R `DISTANCES` from poses ``[*B, 3]``.

    Returns float32 ``[*B, K, R, 2]``.

    Examples:
        >>> north = torch.tensor([1.0, 2.0, 90.0])
        >>> ahead = BEARINGS.tolist().index(0.0)
        >>> spots(north)[ahead, -1].round().tolist()  # six steps to the north of it
        [1.0, 8.0]
    """
    angle = (poses[..., 2:] + BEARINGS).deg2rad()
    way = torch.stack([angle.cos(), angle.sin()], -1).unsqueeze(-2)
    return poses[..., None, None, :2] + DISTANCES.unsqueeze(1) * way
