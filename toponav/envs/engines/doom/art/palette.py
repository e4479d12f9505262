"""The 256 colours of every maze, and how the engine is given them and pictures in them.

Doom draws with 256 fixed colours, and its own have no teal, violet or cyan. Ours are
16 greys, dark to bright, then 20 hues x 3 saturations x 4 values.
"""

import struct
import zlib
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

#: A picture in palette indices, uint8 ``[H, W]``.
Picture: TypeAlias = NDArray[np.uint8]

NUM_GREYS = 16
NUM_HUES = 20
#: Saturations, pale to pure, and values, dark to bright, of the coloured part.
SATURATIONS = np.array([0.32, 0.64, 1.0])
VALUES = np.array([0.3, 0.54, 0.78, 1.0])

_PNG_INDEXED, _PNG_RGBA = 3, 6


def _make_palette() -> NDArray[np.uint8]:
    greys = np.linspace(0, 255, NUM_GREYS)[:, None].repeat(3, axis=1)
    hues, channels = np.arange(NUM_HUES) / NUM_HUES, np.array([5.0, 3.0, 1.0])
    hue, saturation, value, channel = np.ix_(hues, SATURATIONS, VALUES, channels)
    sector = (channel + 6.0 * hue) % 6.0
    ramp = np.clip(np.minimum(sector, 4.0 - sector), 0.0, 1.0)
    shades = 255.0 * (value * (1.0 - saturation * ramp))
    return np.concatenate([greys, shades.reshape(-1, 3)]).round().astype(np.uint8)


#: The palette, RGB, uint8 ``[256, 3]``; entry 0 is black, entry 15 white.
PALETTE = _make_palette()
PALETTE.setflags(write=False)
BLACK, WHITE = 0, 15


def colour_index(hue: float, saturation: int, value: int) -> int:
    """The palette index of the shade whose hue (in turns, red is 0) is nearest.

    Saturation goes from 0 pale to 2 pure, value from 0 dark to 3 bright.
    """
    row = round(hue * NUM_HUES) % NUM_HUES
    return NUM_GREYS + (row * len(SATURATIONS) + saturation) * len(VALUES) + value


def playpal() -> bytes:
    """The ``PLAYPAL`` lump: the engine tints the screen with 14 palettes, all alike."""
    return PALETTE.tobytes() * 14


def colormap() -> bytes:
    """The ``COLORMAP`` lump, ``34 x 256`` bytes: the palette under 32 levels of light.

    Level ``l`` maps an entry to the nearest colour of its RGB times ``1 - l / 32``. Row
    32 is an inverted grey and row 33 black, as the engine expects; neither is seen.
    """
    light = 1.0 - np.arange(32) / 32
    lit = np.round(PALETTE * light[:, None, None]).reshape(-1, 3)
    inverted = 255 - PALETTE.mean(axis=1).astype(np.uint8)
    colours = np.concatenate([lit, inverted[:, None].repeat(3, axis=1)])
    # Whole numbers, so distances are exact, and ties go to the first entry.
    nearest: NDArray[np.int64] = cdist(colours, PALETTE, "sqeuclidean").argmin(axis=1)
    return nearest.astype(np.uint8).tobytes() + bytes(len(PALETTE))


def _chunk(kind: bytes, data: bytes) -> bytes:
    checksum = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)


def encode_png(
    image: NDArray[np.uint8], offsets: tuple[int, int] | None = None
) -> bytes:
    """A PNG file of palette indices ``[H, W]``, or RGBA ``[H, W, 4]`` for sprites.

    ``offsets`` is the pixel (x, y) on the actor's position, from the top left corner,
    in a chunk that ZDoom alone reads: https://zdoom.org/wiki/GrAb
    """
    kind = _PNG_INDEXED if image.ndim == 2 else _PNG_RGBA
    height, width = image.shape[:2]
    # Each line starts with the number of its filter; 0 is none.
    lines = np.pad(image.reshape(height, -1), ((0, 0), (1, 0)))
    chunks = [_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0))]
    if offsets is not None:
        chunks.append(_chunk(b"grAb", struct.pack(">ii", *offsets)))
    if kind == _PNG_INDEXED:
        chunks.append(_chunk(b"PLTE", PALETTE.tobytes()))
    chunks.append(_chunk(b"IDAT", zlib.compress(lines.tobytes())))
    return b"\x89PNG\r\n\x1a\n" + b"".join([*chunks, _chunk(b"IEND", b"")])
