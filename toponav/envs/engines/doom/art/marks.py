"""`marked`: a wall with small marks of its own, so that close views differ too.

From less than a quarter of a cell a view shows a small patch of one wall, and the walls
of a region share one pattern. Most views of a random agent look at a wall from nearby;
without marks a trained network took one in eight of those for a place far away.
"""

import numpy as np

from toponav.envs.engines.doom.art.palette import PALETTE, Bytes, colour_index
from toponav.envs.engines.doom.art.sprites import SHAPES, turned

# Marks across and up; their distance is less than the patch that a close view shows.
_COLUMNS, _ROWS = 5, 5
# Half their size, in pixels, smallest and largest.
_SMALLEST, _LARGEST = 6.0, 11.0
# Half a window that holds the largest, whatever its shape and turn.
_REACH = 18
# Largest distance of their hues from the wall's, in turns: from afar they melt into it.
_HUE_SPREAD = 0.15


def marked(background: Bytes, hue: float, rng: np.random.Generator) -> Bytes:
    """Scatter small random shapes over a copy of a wall, near its hue (in turns).

    The wall is RGB, uint8 ``[H, W, 3]``, in palette colours.
    """
    picture = background.copy()
    height, width = background.shape[:2]
    for row, column in np.ndindex(_ROWS, _COLUMNS):
        x = (column + rng.uniform(0.3, 0.7)) * width / _COLUMNS
        y = (row + rng.uniform(0.3, 0.7)) * height / _ROWS
        size = rng.uniform(_SMALLEST, _LARGEST)
        tone = (hue + rng.uniform(-_HUE_SPREAD, _HUE_SPREAD)) % 1.0
        colour = colour_index(tone, int(rng.integers(3)), int(rng.integers(1, 4)))
        left, top = max(int(x - _REACH), 0), max(int(y - _REACH), 0)
        patch = picture[top : int(y + _REACH), left : int(x + _REACH)]
        v, u = np.indices(patch.shape[:2], dtype=np.float32)
        u, v = (u + left - x) / size, (v + top - y) / size
        shape = SHAPES[rng.integers(len(SHAPES))]
        inside = shape(*turned(u, v, rng.uniform(0, 2 * np.pi))) < 1.0
        patch[inside] = PALETTE[colour]
    return picture
