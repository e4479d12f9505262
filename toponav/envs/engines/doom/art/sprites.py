"""The two things to find, apple and goal, and the shapes that art is drawn of.

A shape is a *gauge*: a function of the plane that is below 1 inside, 1 on the outline
and grows outwards, so ``gauge < 1.15`` is the shape with a border. Pixels pass through
sums, products and square roots only, which every machine rounds alike: the same seed
draws the same picture everywhere.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from toponav.envs.engines.doom.art.palette import BLACK, PALETTE, WHITE, colour_index

#: Coordinates or a gauge, one number per pixel.
Plane: TypeAlias = NDArray[np.floating]
Shape: TypeAlias = Callable[[Plane, Plane], Plane]
Sprite: TypeAlias = NDArray[np.uint8]


def turned(x: Plane, y: Plane, angle: float) -> tuple[Plane, Plane]:
    """Coordinates (rightwards, downwards) rotated about the origin by radians."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * x + sin * y, cos * y - sin * x


def radius(x: Plane, y: Plane) -> Plane:
    """The distance of each pixel from the origin; also the gauge of a disc."""
    distance: Plane = np.sqrt(x * x + y * y)
    return distance


def square(x: Plane, y: Plane) -> Plane:
    """The gauge of a square."""
    return np.maximum(np.abs(x), np.abs(y))


def _star(x: Plane, y: Plane, tips: int, dent: float) -> Plane:
    """Gauge of a star with tips at radius 1 and dents at radius ``dent``."""
    half = math.pi / tips
    slope = (1 - dent * math.cos(half)) / (dent * math.sin(half))
    # Components along the nearest tip and across it.
    along = x
    for turn in (2 * half * tip for tip in range(1, tips)):
        along = np.maximum(along, math.cos(turn) * x + math.sin(turn) * y)
    across = np.sqrt(np.maximum(x * x + y * y - along * along, 0))
    return along + slope * across


#: Shapes of radius about 1 that stay distinct at a few pixels.
SHAPES: tuple[Shape, ...] = (
    radius,
    # A ring, and a crescent.
    lambda x, y: np.abs(radius(x, y) - 0.72) / 0.28,
    lambda x, y: np.maximum(radius(x, y), 1.75 - radius(x - 0.55, y)),
    # A cross, and a bar.
    lambda x, y: np.maximum(np.minimum(np.abs(x), np.abs(y)) / 0.34, square(x, y)),
    lambda x, y: square(x / 1.5, y / 0.32),
    partial(_star, tips=3, dent=0.5),
    partial(_star, tips=4, dent=0.707),
    partial(_star, tips=5, dent=0.42),
    partial(_star, tips=8, dent=0.55),
)


def _plane(height: int, width: int) -> tuple[Plane, Plane]:
    """Pixel centres, rightwards and downwards from the middle."""
    y, x = np.indices((height, width), dtype=np.float32)
    return x - (width - 1) / 2, y - (height - 1) / 2


def _cut_out(index: NDArray[np.int64], solid: NDArray[np.bool_]) -> Sprite:
    """Make RGBA of palette indices; what is not solid is transparent black."""
    rgba = np.zeros((*index.shape, 4), dtype=np.uint8)
    rgba[solid, :3] = PALETTE[index[solid]]
    rgba[solid, 3] = 255
    return rgba


def apple() -> Sprite:
    """A red disc with a black rim, a leaf and a glint: RGBA, uint8 ``[28, 24, 4]``."""
    x, y = _plane(28, 24)
    # Two lobes, so that the top is notched.
    lobes = (radius(x - side, 0.95 * y - 3.5) for side in (-2.5, 2.5))
    body = np.minimum(*lobes) / 9.5
    shadow = radius(x + 3, y - 1) > 10
    glint = radius(x + 5, 0.7 * y) < 2.3
    stem = (np.abs(x + y / 5 + 1) < 1.2) & (y > -13) & (y < -3)
    leaf = np.maximum(radius(x - 2, y + 14), radius(x - 8, y + 7)) / 6.5

    index = np.full(x.shape, BLACK, dtype=np.int64)
    index[body < 0.88] = colour_index(0.0, 2, 3)
    index[(body < 0.88) & shadow] = colour_index(0.0, 2, 2)
    index[glint] = WHITE
    index[stem] = colour_index(0.1, 2, 0)
    index[leaf < 1] = colour_index(0.3, 2, 3)
    return _cut_out(index, (body < 1) | stem | (leaf < 1))


def goal() -> Sprite:
    """A golden star with a white heart on a post: RGBA, uint8 ``[48, 40, 4]``."""
    x, y = _plane(48, 40)
    gold, amber = colour_index(0.15, 2, 3), colour_index(0.1, 2, 3)
    star = _star(*turned(x / 20, (y + 5) / 20, -np.pi / 2), tips=5, dent=0.55)
    post = np.maximum(np.abs(x) / (4 + np.maximum(y - 15, 0)), np.abs(y - 12) / 12)

    index = np.full(x.shape, BLACK, dtype=np.int64)
    index[post < 0.8] = amber
    index[star < 1.0] = BLACK
    index[star < 0.85] = gold
    index[star < 0.4] = WHITE
    return _cut_out(index, (post < 1) | (star < 1))
