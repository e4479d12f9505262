"""Trajectories through a square corridor whose views are nearly their poses."""

from math import cos, radians, sin

import torch
from torch import Tensor

from toponav.graph.trajectories import Trajectory

#: Ahead, left and right: a step, or 20 degrees.
EFFECTS = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 20.0], [0.0, 0.0, -20.0]])
SIDE, INNER = 16.0, (5.0, 11.0)
#: Views around these two corners are the same.
CORNERS = (2.0, 2.0), (14.0, 14.0)


def is_free(x: float, y: float) -> bool:
    """Inside of the outer walls, outside of the inner block."""
    inside = 0 < x < SIDE and 0 < y < SIDE
    return inside and not (INNER[0] < x < INNER[1] and INNER[0] < y < INNER[1])


def look(x: float, y: float, heading: float) -> list[float]:
    """An embedding: the place, the direction, and how far the wall ahead is."""
    ahead, east, north = 0.0, cos(radians(heading)), sin(radians(heading))
    while ahead < 3 and is_free(x + (ahead + 0.25) * east, y + (ahead + 0.25) * north):
        ahead += 0.25
    for corner in CORNERS[1:]:
        if abs(x - corner[0]) + abs(y - corner[1]) < 1.0:
            x, y = x - corner[0] + CORNERS[0][0], y - corner[1] + CORNERS[0][1]
    return [x, y, 2 * east, 2 * north, ahead]


def compare(one: Tensor, many: Tensor) -> Tensor:
    """1 for one pose, 0.78 for one step away."""
    gap = (one.unsqueeze(1) - many)[..., :4]
    return torch.exp(-gap.square().sum(-1) / 4)


def walk(env: int, length: int, seed: int) -> tuple[Trajectory, Tensor]:
    """A sticky random walk, and its true poses ``[T, 3]``, both from a start drawn."""
    generator = torch.Generator().manual_seed(seed)

    def draw() -> float:
        return float(torch.rand((), generator=generator))

    x, y, heading, action = 2.0 + draw(), 8.0 * (0.3 + draw()), 360 * draw(), 0
    views, actions, poses = [], [], []
    for _ in range(length):
        views.append(look(x, y, heading))
        poses.append([x, y, heading])
        if draw() < 0.3:
            action = 0 if draw() < 0.6 else 1 + round(draw())
        actions.append(action)
        step, _, turn = EFFECTS[action].tolist()
        east, north = step * cos(radians(heading)), step * sin(radians(heading))
        # Along a wall it slides.
        x = x + east if is_free(x + east, y) else x
        y = y + north if is_free(x, y + north) else y
        heading += turn
    embeddings = torch.tensor(views).half()
    return Trajectory(env, 0, embeddings, torch.tensor(actions)), torch.tensor(poses)
