"""Which actions follow a path, by what they do to a pose."""

import torch
from torch import Tensor

from toponav.worlds import Motion, WorldSpec

#: Cells along the path at which an agent aims; above 1.4 the line to that point may
#: cross a wall.
_LOOKAHEAD = 1.25
#: Degrees up to which it moves while it turns.
_WIDEST = 60.0


def require_motion(world: WorldSpec) -> Motion:
    """The motion of a world, refused if it has no ground truth."""
    if world.motion is None:
        raise ValueError("world must report poses, got one without ground truth")
    return world.motion


def wrap_degrees(angle: Tensor) -> Tensor:
    """``angle`` in [-180, 180)."""
    return (angle + 180) % 360 - 180


def bearing(start: Tensor, end: Tensor) -> Tensor:
    """Direction from ``start`` to ``end`` in degrees, 0 east, 90 north."""
    x, y = (end - start).unbind(-1)
    return torch.rad2deg(torch.atan2(y, x))


def point_ahead(
    path: Tensor, position: Tensor, *, cell_size: float, lookahead: float
) -> Tensor:
    """The point of ``path`` that lies ``lookahead`` in front of the agent, ``[B, 2]``.

    Aiming at it rounds corners instead of stopping in them (pure pursuit). ``position``
    is in the first cell of the path ``[B, P, 2]``, which may end with repeated points.
    """
    legs = path[:, 1:] - path[:, :-1]
    covered = ((position - path[:, 0]) * legs[:, 0]).sum(-1) / cell_size
    arc = ((covered + lookahead) / cell_size).clamp(0, legs.shape[1])
    leg = arc.floor().clamp(max=legs.shape[1] - 1).long()
    row = torch.arange(len(path), device=path.device)
    return path[row, leg] + (arc - leg).unsqueeze(-1) * legs[row, leg]


class Steering:
    """Chooses the actions that follow a path in a world, cutting its corners.

    The world must report poses, and its actions go ahead and turn to both sides;
    one that turns on the spot and one that turns on the way stand in for each other.

    Examples:
        >>> from toponav.worlds import Effect
        >>> effects = Effect(ahead=2.5), Effect(turn=20), Effect(turn=-20)
        >>> motion = Motion(cell_size=10, effects=effects)
        >>> world = WorldSpec(view_size=(1, 1), actions=(*"alr",), motion=motion)
        >>> Steering(world).towards(torch.tensor([3.0, 30.0, -30.0, 120.0]))
        tensor([0, 1, 2, 1])
    """

    def __init__(self, world: WorldSpec) -> None:
        self.motion = require_motion(world)
        # By whether it goes ahead or stays, and turns right (-1), not, or left (1).
        first: dict[tuple[bool, int], int] = {}
        for number, (ahead, left, turn) in enumerate(self.motion.effects):
            if ahead > 0 or ahead == left == 0:
                first.setdefault((ahead > 0, (turn > 0) - (turn < 0)), number)
        if (True, 0) not in first or {side for _, side in first} != {-1, 0, 1}:
            got = ", ".join(world.actions)
            rule = "world must have actions that go ahead and turn to both sides"
            raise ValueError(f"{rule}, got {got}")
        self.ahead = first[True, 0]
        first = {(not on, side): it for (on, side), it in first.items()} | first
        # Row: on the spot or on the way; column: to the right or to the left.
        order = [[first[on, side] for side in (-1, 1)] for on in (False, True)]
        self.turns = torch.tensor(order)

    def __call__(self, path: Tensor, position: Tensor, heading: Tensor) -> Tensor:
        """The actions ``[B]`` that follow paths of cell centres, the own cell first."""
        size = self.motion.cell_size
        aim = point_ahead(path, position, cell_size=size, lookahead=_LOOKAHEAD * size)
        return self.towards(wrap_degrees(bearing(position, aim) - heading))

    def towards(self, off: Tensor) -> Tensor:
        """The actions that turn left by ``off`` degrees, int64 ``[B]``."""
        action = self.turns[(off.abs() <= _WIDEST).long(), (off > 0).long()]
        return action.masked_fill(off.abs() <= self.motion.turn / 2, self.ahead)
