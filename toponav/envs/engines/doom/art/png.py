"""PNG files as the engine reads them: palette-indexed, with sprite offsets."""

import struct
import zlib

import numpy as np

from toponav.envs.engines.doom.art.palette import PALETTE, Bytes, quantise

_INDEXED, _RGBA = 3, 6


def _chunk(kind: bytes, data: bytes) -> bytes:
    checksum = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)


def encode_png(image: Bytes, offsets: tuple[int, int] | None = None) -> bytes:
    r"""Encode a picture in the maze's palette; the same input gives the same bytes.

    Sprites stay RGBA, because the palette has no transparent entry.

    Reference:
        "grAb", a private chunk read by ZDoom. https://zdoom.org/wiki/GrAb

    Args:
        image: uint8; palette indices ``[H, W]``, RGB ``[H, W, 3]``, RGBA ``[H, W, 4]``.
        offsets: the pixel (x, y) on the actor's position, from the top left corner.

    Raises:
        ValueError: if the picture has another dtype or shape, or no pixel.
    """
    channels = image.shape[2] if image.ndim == 3 else 1
    known = (image.ndim, channels) in {(2, 1), (3, 3), (3, 4)}
    if image.dtype != np.uint8 or not known or image.size == 0:
        raise ValueError(
            "image must be uint8 [H, W], [H, W, 3] or [H, W, 4] and not empty, "
            f"got {image.dtype} {image.shape}"
        )
    kind = _RGBA if channels == 4 else _INDEXED
    pixels = image if channels == 1 else quantise(image[..., :3])
    if kind == _RGBA:
        pixels = np.concatenate([PALETTE[pixels], image[..., 3:]], axis=2)
    height, width = pixels.shape[:2]
    # Each line starts with the number of its filter; 0 is none.
    lines = np.pad(pixels.reshape(height, -1), ((0, 0), (1, 0)))
    chunks = [_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0))]
    if offsets is not None:
        chunks.append(_chunk(b"grAb", struct.pack(">ii", *offsets)))
    if kind == _INDEXED:
        chunks.append(_chunk(b"PLTE", PALETTE.tobytes()))
    chunks.append(_chunk(b"IDAT", zlib.compress(lines.tobytes())))
    return b"\x89PNG\r\n\x1a\n" + b"".join([*chunks, _chunk(b"IEND", b"")])
