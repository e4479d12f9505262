"""Actions by name: what they do to a pose, and which one follows a path."""

import torch
from torch import Tensor

from toponav.worlds import Motion, WorldSpec

#: Steps ahead and turns to the left of the actions that ground truth understands.
EFFECTS = {
    "forward": (1.0, 0.0),
    "backward": (-1.0, 0.0),
    "left": (0.0, 1.0),
    "right": (0.0, -1.0),
    "forward+left": (1.0, 1.0),
    "forward+right": (1.0, -1.0),
}
_STEERED_BY = ("forward", "left", "right", "forward+left", "forward+right")
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

    The world must report poses; its actions are looked up by name.

    Examples:
        >>> motion = Motion(cell_size=10, step=2.5, turn=20)
        >>> world = WorldSpec(view_size=(1, 1), actions=tuple(EFFECTS), motion=motion)
        >>> Steering(world).towards(torch.tensor([3.0, 30.0, -30.0, 120.0]))
        tensor([0, 4, 5, 2])
    """

    def __init__(self, world: WorldSpec) -> None:
        self.motion = require_motion(world)
        if not set(_STEERED_BY) <= set(world.actions):
            wanted, got = ", ".join(_STEERED_BY), ", ".join(world.actions)
            raise ValueError(f"world must have the actions {wanted}, got {got}")
        self.actions = {name: world.actions.index(name) for name in _STEERED_BY}

    def __call__(self, path: Tensor, position: Tensor, heading: Tensor) -> Tensor:
        """The actions ``[B]`` that follow paths of cell centres, the own cell first."""
        size = self.motion.cell_size
        aim = point_ahead(path, position, cell_size=size, lookahead=_LOOKAHEAD * size)
        return self.towards(wrap_degrees(bearing(position, aim) - heading))

    def towards(self, off: Tensor) -> Tensor:
        """The actions that turn left by ``off`` degrees, int64 ``[B]``."""
        number, left = self.actions, off > 0
        moving = torch.where(left, number["forward+left"], number["forward+right"])
        on_the_spot = torch.where(left, number["left"], number["right"])
        action = torch.where(off.abs() <= _WIDEST, moving, on_the_spot)
        return action.masked_fill(off.abs() <= self.motion.turn / 2, number["forward"])
