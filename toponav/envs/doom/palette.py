"""The 256 colours of every maze, and the two lumps that teach them to the engine.

Doom draws with 256 fixed colours, and its own have no teal, violet or cyan. Ours
are computed: 16 greys, then 20 hues x 3 saturations x 4 values.

- :data:`PALETTE`: the colours, uint8 ``[256, 3]``.
- :func:`colour_index`: a colour by hue, saturation and value.
- :func:`quantise`: an RGB picture to the nearest colours.
- :func:`playpal`, :func:`colormap`: the lumps ``PLAYPAL`` and ``COLORMAP``.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

#: A picture or a table of bytes; each function states its shape.
Bytes: TypeAlias = NDArray[np.uint8]

NUM_GREYS = 16
NUM_HUES = 20
#: Saturations, pale to pure, and values, dark to bright, of the coloured part.
SATURATIONS = (0.32, 0.64, 1.0)
VALUES = (0.3, 0.54, 0.78, 1.0)

_NUM_FLASHES = 14
_NUM_LIGHT_LEVELS = 32
#: Rows of the distance matrix held at once; bounds its memory to 4 MB.
_CHUNK = 4096


def _hsv_to_rgb(hue: NDArray[np.float64], saturation: float, value: float) -> Bytes:
    """Turn hues in [0, 1) into RGB, uint8 ``[N, 3]``."""
    sector = (np.array([5.0, 3.0, 1.0]) + 6.0 * hue[:, None]) % 6.0
    ramp = np.clip(np.minimum(sector, 4.0 - sector), 0.0, 1.0)
    rgb = value * (1.0 - saturation * ramp)
    return np.round(255.0 * rgb).astype(np.uint8)


def _make_palette() -> Bytes:
    """Compute the 256 colours: greys dark to bright, then hue by hue."""
    greys = np.linspace(0, 255, NUM_GREYS).astype(np.uint8)[:, None].repeat(3, axis=1)
    hues = np.arange(NUM_HUES) / NUM_HUES
    shades = [_hsv_to_rgb(hues, s, v) for s in SATURATIONS for v in VALUES]
    return np.concatenate([greys, np.stack(shades, axis=1).reshape(-1, 3)])


#: The palette, RGB, uint8 ``[256, 3]``; entry 0 is black, entry 15 white.
PALETTE: Bytes = _make_palette()
PALETTE.setflags(write=False)


def colour_index(hue: float, saturation: int, value: int) -> int:
    """Return the palette index of the shade whose hue is nearest.

    Art drawn in these shades passes :func:`quantise` unchanged, so no colour of
    it lies between two entries and breaks up into speckle.

    Args:
        hue: position on the colour circle in turns; 0 is red, 1/3 green, 2/3
            blue. Only its fractional part counts.
        saturation: 0 pale, 1 medium, 2 pure.
        value: 0 dark to 3 bright.

    Returns:
        An index in ``[16, 256)``.

    Examples:
        >>> PALETTE[colour_index(0.3, 2, 3)]
        array([ 51, 255,   0], dtype=uint8)
    """
    row = round(hue * NUM_HUES) % NUM_HUES
    per_hue = len(SATURATIONS) * len(VALUES)
    return NUM_GREYS + row * per_hue + saturation * len(VALUES) + value


def _nearest(rgb: Bytes) -> Bytes:
    """Find the nearest palette entry of each row of ``[N, 3]``; ties go to the first.

    ``|p|^2 - 2 c.p`` orders entries as ``|c - p|^2`` does, and all its terms are
    integers below 2^24, so float32 is exact.
    """
    entries = PALETTE.astype(np.float32)
    squares = np.square(entries).sum(axis=1)
    index = np.empty(len(rgb), dtype=np.uint8)
    for start in range(0, len(rgb), _CHUNK):
        part = rgb[start : start + _CHUNK].astype(np.float32)
        index[start : start + _CHUNK] = np.argmin(
            squares - 2.0 * part @ entries.T, axis=1
        )
    return index


def quantise(rgb: Bytes) -> Bytes:
    """Map a picture to the indices of its nearest palette colours.

    Distance is Euclidean in RGB, without dithering. Each distinct colour is
    looked up once, so drawn art is fast and a photograph is still exact.

    Args:
        rgb: picture, uint8 ``[H, W, 3]``.

    Returns:
        Palette indices, uint8 ``[H, W]``.

    Raises:
        ValueError: if ``rgb`` is not uint8 ``[H, W, 3]``.

    Examples:
        >>> quantise(np.array([[[0, 0, 0], [250, 254, 255]]], dtype=np.uint8))
        array([[ 0, 15]], dtype=uint8)
    """
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
        raise ValueError(f"rgb must be uint8 [H, W, 3], got {rgb.dtype} {rgb.shape}")
    wide = rgb.astype(np.int32)
    codes = (wide[..., 0] << 16 | wide[..., 1] << 8 | wide[..., 2]).ravel()
    colours, inverse = np.unique(codes, return_inverse=True)
    distinct = np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=1)
    index: Bytes = _nearest(distinct.astype(np.uint8))[inverse]
    return index.reshape(rgb.shape[:2])


def playpal() -> bytes:
    """Return the ``PLAYPAL`` lump: the palette, and no flash of pain or pickup.

    The engine switches among 14 palettes to tint the screen; all 14 are alike.

    Returns:
        ``14 x 256 x 3`` bytes.

    Examples:
        >>> len(playpal())
        10752
    """
    return PALETTE.tobytes() * _NUM_FLASHES


def colormap() -> bytes:
    """Return the ``COLORMAP`` lump: the palette under 32 levels of light.

    Level ``l`` maps an entry to the nearest colour of its RGB times
    ``1 - l / 32``. Row 32 is the inverted grey of invulnerability and row 33 all
    black, as the engine expects; neither is seen in a maze.

    Returns:
        ``34 x 256`` bytes, row by row.

    Examples:
        >>> colormap()[:256] == bytes(range(256))
        True
    """
    light = 1.0 - np.arange(_NUM_LIGHT_LEVELS) / _NUM_LIGHT_LEVELS
    lit = np.round(PALETTE * light[:, None, None]).astype(np.uint8)
    inverted = 255 - PALETTE.mean(axis=1).astype(np.uint8)
    rows = np.concatenate([lit, inverted[None, :, None].repeat(3, axis=2)])
    return quantise(rows).tobytes() + bytes(len(PALETTE))
