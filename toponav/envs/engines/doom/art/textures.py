"""Wall, floor, painting, mark, sky and door pictures, in palette indices.

All are seen in small views from up to a dozen cells away, so they are made of few, big,
flat shapes. Style and hue of walls and floors say which region of the maze this is, a
painting which cell, and marks which patch of a wall. A generator draws what varies.
"""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from toponav.envs.engines.doom.art.palette import BLACK, WHITE, Picture, colour_index
from toponav.envs.engines.doom.art.sprites import SHAPES, Plane, radius, square, turned

#: Width and height of a wall or floor in pixels.
SIZE = 128

Levels: TypeAlias = NDArray[np.int64]
Pattern: TypeAlias = Callable[[np.random.Generator], Levels]

_Y, _X = np.indices((SIZE, SIZE))
#: (saturation, value) of each level that a pattern may hold, dark to light.
_WALL_SHADES = ((2, 0), (2, 1), (1, 2), (1, 3), (0, 3))
_FLOOR_SHADES = ((1, 0), (0, 1), (1, 1), (0, 2), (1, 2))

# Marks across and up; their distance is less than the patch that a close view shows.
_COLUMNS, _ROWS = 5, 5
# Half their size, in pixels, smallest and largest.
_SMALLEST, _LARGEST = 6.0, 11.0
# Half a window that holds the largest, whatever its shape and turn.
_REACH = 18
# Largest distance of their hues from the wall's, in turns: from afar they melt into it.
_HUE_SPREAD = 0.15


def _bricks(rng: np.random.Generator) -> Levels:
    shifted = (_X + 32 * (_Y // 32 % 2)) % SIZE
    levels: Levels = rng.integers(2, 4, size=(4, 2))[_Y // 32, shifted // 64]
    levels[(_Y % 32 < 4) | (shifted % 64 < 4)] = 0
    return levels


def _stripes(rng: np.random.Generator) -> Levels:
    across = (_X + _Y + rng.integers(64)) % 64
    return np.select([across < 28, across < 34, across < 58], [1, 4, 3], 4)


def _checker(rng: np.random.Generator) -> Levels:
    odd = (_X // 32 + _Y // 32 + rng.integers(2)) % 2
    rim = np.minimum(_X % 32, _Y % 32) < 3
    return np.where(odd == 1, np.where(rim, 3, 4), np.where(rim, 0, 1))


def _planks(rng: np.random.Generator) -> Levels:
    plank = _X // 32
    levels: Levels = rng.integers(2, 4, size=4)[plank]
    joint = rng.integers(32, 96, size=4)[plank]
    levels[(_X % 32 < 3) | (np.abs(_Y - joint) < 2)] = 0
    levels[_X % 32 // 3 == 2] = 4
    return levels


def _stone(rng: np.random.Generator) -> Levels:
    grid = np.indices((4, 4)).reshape(2, 16) * 32
    seeds = grid + rng.integers(0, 28, size=grid.shape)
    away = np.abs(np.arange(SIZE, dtype=np.float32) - seeds[:, :, None])
    # Distances wrap around, so that the stones go on over the edge.
    dy, dx = np.minimum(away, SIZE - away)
    distance = radius(dy[:, :, None], dx[:, None, :])
    first, second = np.partition(distance, 1, axis=0)[:2]
    levels: Levels = rng.integers(1, 4, size=16)[distance.argmin(axis=0)]
    levels[second - first < 6] = 4
    return levels


def _scales(rng: np.random.Generator) -> Levels:
    levels = np.zeros((SIZE, SIZE), dtype=np.int64)
    shades = rng.integers(1, 4, size=(4, 2))
    # Lower rows first: each scale hides the upper half of those below it.
    for row in range(4, -2, -1):
        shifted = (_X + 32 * (row % 2)) % SIZE
        away = radius(shifted % 64 - 32.0, _Y - 32.0 * row)
        inside = shades[row % 4, shifted // 64]
        levels = np.where(away < 36, np.where(away < 31, inside, 4), levels)
    return levels


def _tiles(rng: np.random.Generator) -> Levels:
    levels: Levels = rng.integers(1, 4, size=(4, 4))[_Y // 32, _X // 32]
    levels[(_X % 32 < 2) | (_Y % 32 < 2)] = 0
    return levels


def _boards(rng: np.random.Generator) -> Levels:
    return _planks(rng).T


def _diamonds(rng: np.random.Generator) -> Levels:
    ring = np.abs(_X % 64 - 32) + np.abs(_Y % 64 - 32)
    return np.where((ring < 32) ^ bool(rng.integers(2)), 1, 3)


def _weave(rng: np.random.Generator) -> Levels:
    upright = (_X // 64 + _Y // 64 + rng.integers(2)) % 2 == 1
    across = np.where(upright, _X, _Y) % 64
    return np.where(across % 16 < 3, 0, np.where(upright, 2, 4))


def _dots(rng: np.random.Generator) -> Levels:
    shift = 32 * (_Y // 32 % 2) + 16 * int(rng.integers(2))
    away = radius((_X + shift) % 64 - 32.0, _Y % 32 - 16.0)
    return np.where(away < 12, 4, 1)


_WALLS: tuple[Pattern, ...] = (_bricks, _stripes, _checker, _planks, _stone, _scales)
_FLOORS: tuple[Pattern, ...] = (_tiles, _boards, _diamonds, _stone, _weave, _dots)
#: Wall styles, and as many floor styles.
NUM_STYLES = len(_WALLS)


def _shade(levels: Levels, hue: float, shades: tuple[tuple[int, int], ...]) -> Picture:
    colours = np.array([colour_index(hue, *shade) for shade in shades], np.uint8)
    return colours[levels]


def wall(style: int, hue: float, rng: np.random.Generator) -> Picture:
    """A bright pattern between a dark skirting and a dark cornice, ``[128, 128]``."""
    levels = _WALLS[style](rng)
    levels[:5] = levels[-8:] = 0
    return _shade(levels, hue, _WALL_SHADES)


def floor(style: int, hue: float, rng: np.random.Generator) -> Picture:
    """A floor, duller than any wall so that the two never merge, ``[128, 128]``."""
    return _shade(_FLOORS[style](rng), hue, _FLOOR_SHADES)


def sky(rng: np.random.Generator) -> Picture:
    """A sky with clouds everywhere, so that none is a landmark, ``[128, 256]``."""
    shape = (SIZE, 2 * SIZE)
    # Noise with only long waves, longer across than up: flat, periodic clouds.
    up, across = np.ogrid[-SIZE // 2 : SIZE // 2, : SIZE + 1]
    waves = np.fft.ifftshift(radius(across / 4, up / 9), axes=0)
    noise = np.fft.rfft2(rng.standard_normal(shape))
    density = np.fft.irfft2(noise * np.exp(-waves * waves) * (waves > 0.4), s=shape)
    level = np.digitize(density / density.std(), [0.4, 0.8, 1.3])
    blues = [colour_index(0.6, 1, 3), colour_index(0.6, 0, 3), 14, WHITE]
    picture: Picture = np.array(blues, np.uint8)[level]
    return picture


def door() -> Picture:
    """A closed slot: red boards behind yellow and black tape, ``[128, 128]``."""
    index = np.where(_X % 32 < 3, colour_index(0.0, 2, 0), colour_index(0.05, 2, 2))
    index[_X % 32 // 3 == 1] = colour_index(0.05, 2, 3)
    rim = np.minimum(np.minimum(_X, SIZE - 1 - _X), np.minimum(_Y, SIZE - 1 - _Y)) < 6
    index[rim] = colour_index(0.0, 2, 0)
    tape = np.where((_X + _Y) % 32 < 16, colour_index(0.15, 2, 3), BLACK)
    band = (np.abs(_Y - 36) < 14) | (np.abs(_Y - 92) < 14)
    return np.where(band, tape, index).astype(np.uint8)


#: Ways to split a canvas of [-1, 1] squared in two tones.
_BACKDROPS: tuple[Callable[[Plane, Plane], NDArray[np.bool_]], ...] = (
    lambda u, v: u > 2,
    lambda u, v: u > 0,
    lambda u, v: v > 0,
    lambda u, v: u > v,
    lambda u, v: abs(radius(u, v) - 0.6) < 0.2,
    lambda u, v: (u > 0) ^ (v > 0) ^ (abs(u) > abs(v)),
)
#: Outlines of a painting: below 1 inside.
_FORMATS: tuple[Callable[[Plane, Plane], Plane], ...] = (
    square,
    radius,
    lambda u, v: (abs(u) + abs(v)) / 1.1,
)


def _shapes(
    canvas: Levels, x: Plane, y: Plane, hue: float, rng: np.random.Generator
) -> None:
    """Paint one to three shapes, each around a smaller one, in other hues."""
    count = int(rng.integers(1, 4))
    start, away = rng.uniform(0, 2 * math.pi), 0 if count == 1 else 28
    for number in range(count):
        turn = start + 2 * math.pi * number / count
        size = (34, 24, 20)[count - 1] * rng.uniform(0.9, 1.1)
        u = (x - away * math.cos(turn)) / size
        v = (y - 0.8 * away * math.sin(turn)) / size
        u, v = turned(u, v, rng.uniform(0, 2 * math.pi))
        outer, inner = rng.choice(len(SHAPES), 2, replace=False)
        tone = hue + rng.uniform(0.2, 0.8)
        gauge = SHAPES[outer](u, v)
        canvas[gauge < 1.15] = BLACK
        canvas[gauge < 1.0] = colour_index(tone, 2, int(rng.integers(2, 4)))
        canvas[SHAPES[inner](2.4 * u, 2.4 * v) < 1.0] = colour_index(tone + 0.5, 1, 3)


def painting(background: Picture, rng: np.random.Generator) -> Picture:
    """Hang a framed picture of random bright shapes on a wall, ``[128, 128]``."""
    # The middle hangs a little above the eye, which is 48 units off the floor.
    x, y = (_X - 63.5).astype(np.float32), (_Y - 59.5).astype(np.float32)
    u, v = x / int(rng.integers(40, 56)), y / int(rng.integers(36, 52))
    edge = _FORMATS[rng.choice(3, p=(0.6, 0.25, 0.15))](u, v)

    hue = rng.uniform()
    split = _BACKDROPS[rng.integers(len(_BACKDROPS))](u, v)
    canvas = np.where(split, colour_index(hue, 0, 3), colour_index(hue, 1, 3))
    _shapes(canvas, x, y, hue, rng)
    vivid = colour_index(hue + rng.uniform(0.2, 0.8), 2, 3)
    frame = rng.choice((vivid, BLACK, WHITE), p=(0.5, 0.25, 0.25))
    canvas[edge > 0.86] = frame
    canvas[(edge > 0.84) & (edge < 0.88) | (edge > 0.98)] = BLACK
    return np.where(edge < 1.02, canvas, background).astype(np.uint8)


def marked(background: Picture, hue: float, rng: np.random.Generator) -> Picture:
    """Scatter small random shapes over a copy of a wall, near its hue (in turns)."""
    picture = background.copy()
    height, width = background.shape
    for row, column in np.ndindex(_ROWS, _COLUMNS):
        x = (column + rng.uniform(0.3, 0.7)) * width / _COLUMNS
        y = (row + rng.uniform(0.3, 0.7)) * height / _ROWS
        size = rng.uniform(_SMALLEST, _LARGEST)
        tone = (hue + rng.uniform(-_HUE_SPREAD, _HUE_SPREAD)) % 1.0
        colour = colour_index(tone, int(rng.integers(3)), int(rng.integers(1, 4)))
        left, top = max(int(x - _REACH), 0), max(int(y - _REACH), 0)
        patch = picture[top : int(y + _REACH), left : int(x + _REACH)]
        v, u = np.indices(patch.shape, dtype=np.float32)
        u, v = (u + left - x) / size, (v + top - y) / size
        shape = SHAPES[rng.integers(len(SHAPES))]
        patch[shape(*turned(u, v, rng.uniform(0, 2 * np.pi))) < 1.0] = colour
    return picture
