"""The 256 colours of every maze, and the two lumps that give them to the engine.

Doom draws with 256 fixed colours, and its own have no teal, violet or cyan. Ours are
16 greys, dark to bright, then 20 hues x 3 saturations x 4 values.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

#: A picture or a table of bytes; each function states its shape.
Bytes: TypeAlias = NDArray[np.uint8]

NUM_GREYS = 16
NUM_HUES = 20
#: Saturations, pale to pure, and values, dark to bright, of the coloured part.
SATURATIONS = (0.32, 0.64, 1.0)
VALUES = (0.3, 0.54, 0.78, 1.0)

_NUM_FLASHES = 14
_NUM_LIGHT_LEVELS = 32


def _make_palette() -> Bytes:
    greys = np.linspace(0, 255, NUM_GREYS).astype(np.uint8)[:, None].repeat(3, axis=1)
    hues = np.arange(NUM_HUES)[:, None, None, None] / NUM_HUES
    sector = (np.array([5.0, 3.0, 1.0]) + 6.0 * hues) % 6.0
    ramp = np.clip(np.minimum(sector, 4.0 - sector), 0.0, 1.0)
    saturations, values = (
        np.array(SATURATIONS)[:, None, None],
        np.array(VALUES)[:, None],
    )
    shades = np.round(255.0 * (values * (1.0 - saturations * ramp))).astype(np.uint8)
    return np.concatenate([greys, shades.reshape(-1, 3)])


#: The palette, RGB, uint8 ``[256, 3]``; entry 0 is black, entry 15 white.
PALETTE: Bytes = _make_palette()
PALETTE.setflags(write=False)
BLACK, WHITE = 0, 15


def colour_index(hue: float, saturation: int, value: int) -> int:
    """The palette index of the shade whose hue (in turns, red is 0) is nearest.

    Saturation goes from 0 pale to 2 pure, value from 0 dark to 3 bright. Art drawn in
    these shades passes `quantise` unchanged, so none of it breaks up into speckle.
    """
    row = round(hue * NUM_HUES) % NUM_HUES
    per_hue = len(SATURATIONS) * len(VALUES)
    return NUM_GREYS + row * per_hue + saturation * len(VALUES) + value


def quantise(rgb: Bytes) -> Bytes:
    """Palette indices ``[H, W]`` of the colours nearest in RGB, without dithering.

    Raises:
        ValueError: if ``rgb`` is not uint8 ``[H, W, 3]``.
    """
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
        raise ValueError(f"rgb must be uint8 [H, W, 3], got {rgb.dtype} {rgb.shape}")
    # One number a colour: unique rows would take forty times as long.
    codes = rgb.reshape(-1, 3).astype(np.int32) @ np.array([1 << 16, 1 << 8, 1])
    codes, inverse = np.unique(codes, return_inverse=True)
    colours = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1)
    # Whole numbers, so they are exact, and ties go to the first entry.
    distances = cdist(colours, PALETTE, "sqeuclidean")
    index: Bytes = distances.argmin(axis=1).astype(np.uint8)[inverse]
    return index.reshape(rgb.shape[:2])


def playpal() -> bytes:
    """The ``PLAYPAL`` lump: the engine tints the screen with 14 palettes, all alike."""
    return PALETTE.tobytes() * _NUM_FLASHES


def colormap() -> bytes:
    """The ``COLORMAP`` lump, ``34 x 256`` bytes: the palette under 32 levels of light.

    Level ``l`` maps an entry to the nearest colour of its RGB times ``1 - l / 32``. Row
    32 is an inverted grey and row 33 black, as the engine expects; neither is seen.
    """
    light = 1.0 - np.arange(_NUM_LIGHT_LEVELS) / _NUM_LIGHT_LEVELS
    lit = np.round(PALETTE * light[:, None, None]).astype(np.uint8)
    inverted = 255 - PALETTE.mean(axis=1).astype(np.uint8)
    rows = np.concatenate([lit, inverted[None, :, None].repeat(3, axis=2)])
    return quantise(rows).tobytes() + bytes(len(PALETTE))
