"""Poses in the frame that a map has by the agent's own actions."""

from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

#: Poses ``[..., 3]``: positions in steps, headings in degrees.
Array = TypeVar("Array", Tensor, NDArray[np.float64])


def decisions_apart(one: Array, other: Array, turn: float) -> Array:
    """Least decisions between poses in free space: steps plus turns; they broadcast.

    Poses ``[..., 3]`` are positions in steps and headings in degrees; ``turn`` is what
    the fastest action turns.

    Examples:
        >>> here, there = np.array([0.0, 0, 350]), np.array([3.0, 4, 30])
        >>> float(decisions_apart(here, there, 20.0))  # 5 steps and 40 / 20 turns
        7.0
    """
    gap = one - other
    steps = (gap[..., 0] ** 2 + gap[..., 1] ** 2) ** 0.5
    return steps + abs((gap[..., 2] + 180) % 360 - 180) / turn


def moved(poses: Tensor, effects: Tensor) -> Tensor:
    """Poses ``[..., 3]`` after actions of ``effects`` ``[..., 3]``; they broadcast.

    Effects are steps ahead and to the left, and degrees to the left.

    Examples:
        >>> here, ahead = torch.tensor([1.0, 2.0, 90.0]), torch.tensor([1.0, 0.0, 20.0])
        >>> moved(here, ahead).round(decimals=3).tolist()
        [1.0, 3.0, 110.0]
    """
    angle = poses[..., 2].deg2rad()
    cos, sin = angle.cos(), angle.sin()
    ahead, left, turn = effects.unbind(-1)
    change = [ahead * cos - left * sin, ahead * sin + left * cos, turn + 0 * angle]
    return poses + torch.stack(change, -1)


def poses_by_actions(effects: Tensor) -> Tensor:
    """Poses ``[T, 3]`` of T views by the ``effects`` ``[T, 3]`` of what follows each.

    They are seen from the first view, as if nothing had stopped the agent.

    Examples:
        >>> ahead, turn = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 90.0]])
        >>> poses = poses_by_actions(torch.stack([ahead, turn, ahead, ahead]))
        >>> poses.round(decimals=3).abs().tolist()  # -0.0 is 0
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 90.0], [1.0, 1.0, 90.0]]
    """
    effects = effects.double()
    turned = torch.zeros_like(effects)
    turned[:, 2] = effects[:, 2].cumsum(0) - effects[:, 2]
    steps = moved(turned, effects) - turned
    return steps.cumsum(0) - steps


def fastest_turn(effects: Tensor) -> float:
    """Degrees that the fastest of actions with these ``effects`` ``[A, 3]`` turns."""
    return float(effects[:, 2].abs().max())
