"""From a path of points to one of the six actions."""

from dataclasses import dataclass
from enum import IntEnum

import torch
from torch import Tensor


class Action(IntEnum):
    """The six discrete actions, as the maze numbers them."""

    FORWARD = 0
    BACKWARD = 1
    LEFT = 2
    RIGHT = 3
    FORWARD_LEFT = 4
    FORWARD_RIGHT = 5


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What one decision does: a step in map units and a turn in degrees.

    Args:
        cell_size: side of a cell in map units.
        step: map units walked in one forward decision.
        turn: degrees turned in one turning decision.
    """

    cell_size: float = 128.0
    step: float = 33.1
    turn: float = 20.0

    @property
    def decisions_per_cell(self) -> float:
        """How many forward decisions cross a cell."""
        return self.cell_size / self.step


def cell_centres(cells: Tensor, num_rows: int, cell_size: float) -> Tensor:
    """Return the middle of cells of the layout text in map units.

    Args:
        cells: ``[*B, 2]``, row (0 is the north end) and column.
        num_rows: of the layout.
        cell_size: side of a cell in map units.

    Returns:
        float32 ``[*B, 2]``: x (east) and y (north).

    Examples:
        >>> cell_centres(torch.tensor([0, 2]), 3, 128.0)
        tensor([320., 320.])
    """
    row, column = cells.to(torch.float32).unbind(-1)
    return torch.stack([column + 0.5, num_rows - row - 0.5], -1) * cell_size


def wrap_degrees(angle: Tensor) -> Tensor:
    """Return ``angle`` in [-180, 180)."""
    return (angle + 180) % 360 - 180


def bearing(start: Tensor, end: Tensor) -> Tensor:
    """Return the direction from ``start`` to ``end`` in degrees, 0 east, 90 north."""
    x, y = (end - start).unbind(-1)
    return torch.rad2deg(torch.atan2(y, x))


def point_ahead(
    path: Tensor, position: Tensor, *, cell_size: float, lookahead: float
) -> Tensor:
    """Return the point of ``path`` that lies ``lookahead`` in front of the agent.

    Walking towards a point that runs ahead on the path rounds corners instead
    of stopping to turn in them (pure pursuit).

    Args:
        path: ``[B, P, 2]``, cell centres ``cell_size`` apart in map units; a
            path that ends early repeats its last point.
        position: ``[B, 2]``; in the first cell of the path.
        cell_size: side of a cell in map units.
        lookahead: map units along the path.

    Returns:
        ``[B, 2]``.

    Examples:
        >>> corner = torch.tensor([[[0.0, 0.0], [128.0, 0.0], [128.0, 128.0]]])
        >>> here = torch.tensor([[28.0, 5.0]])
        >>> point_ahead(corner, here, cell_size=128.0, lookahead=150.0)
        tensor([[128.,  50.]])
    """
    legs = path[:, 1:] - path[:, :-1]
    walked = ((position - path[:, 0]) * legs[:, 0]).sum(-1) / cell_size
    arc = ((walked + lookahead) / cell_size).clamp(0, legs.shape[1])
    leg = arc.floor().clamp(max=legs.shape[1] - 1).long()
    row = torch.arange(len(path), device=path.device)
    return path[row, leg] + (arc - leg).unsqueeze(-1) * legs[row, leg]


def steer(off: Tensor, *, turn: float, widest: float) -> Tensor:
    """Choose the action that brings the heading to a direction.

    Args:
        off: ``[B]``, degrees from the heading to the wanted direction, positive
            to the left.
        turn: degrees of one turning decision; off by less than half of it, the
            agent walks straight on.
        widest: up to this many degrees the agent walks while it turns, beyond
            it turns on the spot.

    Returns:
        int64 ``[B]``, see :class:`Action`.

    Examples:
        >>> steer(torch.tensor([3.0, 30.0, -30.0, 120.0]), turn=20.0, widest=50.0)
        tensor([0, 4, 5, 2])
    """
    left = off > 0
    while_walking = torch.where(left, Action.FORWARD_LEFT, Action.FORWARD_RIGHT)
    on_the_spot = torch.where(left, Action.LEFT, Action.RIGHT)
    action = torch.where(off.abs() <= widest, while_walking, on_the_spot)
    return action.masked_fill(off.abs() <= turn / 2, Action.FORWARD)


def follow(
    path: Tensor,
    position: Tensor,
    heading: Tensor,
    *,
    motion: Motion,
    lookahead: float = 1.25,
    widest: float = 60.0,
) -> Tensor:
    """Choose the action that walks on along ``path``, cutting its corners.

    Args:
        path: ``[B, P, 2]``, cell centres in map units, the agent's cell first.
        position: ``[B, 2]`` in map units.
        heading: ``[B]`` in degrees.
        motion: what one decision does.
        lookahead: cells along the path at which the agent aims; above 1.4 the
            way there may cross a wall.
        widest: see :func:`steer`.

    Returns:
        int64 ``[B]``, see :class:`Action`.
    """
    aim = point_ahead(
        path,
        position,
        cell_size=motion.cell_size,
        lookahead=lookahead * motion.cell_size,
    )
    off = wrap_degrees(bearing(position, aim) - heading)
    return steer(off, turn=motion.turn, widest=widest)
