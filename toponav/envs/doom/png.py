"""PNG files as the engine reads them: palette-indexed, with sprite offsets."""

import struct
import zlib

import numpy as np

from toponav.envs.doom.palette import PALETTE, Bytes, quantise

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_INDEXED, _RGBA = 3, 6


def _chunk(kind: bytes, data: bytes) -> bytes:
    """Frame one chunk: length, kind, data, checksum."""
    checksum = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)


def _to_palette(image: Bytes) -> Bytes:
    """Bring a picture to palette indices ``[H, W]`` or palette RGBA ``[H, W, 4]``."""
    if image.ndim == 2:
        return image
    index = quantise(image[..., :3])
    if image.shape[2] == 3:
        return index
    return np.concatenate([PALETTE[index], image[..., 3:]], axis=2)


def encode_png(image: Bytes, offsets: tuple[int, int] | None = None) -> bytes:
    r"""Encode a picture in the maze's palette.

    Textures become palette-indexed files. Sprites stay RGBA, because the palette
    has no transparent entry, but their colours are the palette's as well. The
    same input gives the same bytes under the same zlib.

    Reference:
        "grAb", a private chunk read by ZDoom. https://zdoom.org/wiki/GrAb

    Args:
        image: uint8; palette indices ``[H, W]``, RGB ``[H, W, 3]`` or RGBA
            ``[H, W, 4]``.
        offsets: the pixel ``(x, y)`` that stands on the actor's position, in
            pixels right of and below the top left corner; written as ``grAb``.

    Returns:
        The file's bytes.

    Raises:
        ValueError: if ``image`` has another dtype or shape, or no pixel.

    Examples:
        >>> encode_png(np.zeros((128, 128), dtype=np.uint8))[:4]
        b'\x89PNG'
    """
    channels = image.shape[2] if image.ndim == 3 else 1
    known = (image.ndim, channels) in {(2, 1), (3, 3), (3, 4)}
    if image.dtype != np.uint8 or not known or image.size == 0:
        raise ValueError(
            "image must be uint8 [H, W], [H, W, 3] or [H, W, 4] and not empty, "
            f"got {image.dtype} {image.shape}"
        )
    pixels = _to_palette(image)
    height, width = pixels.shape[:2]
    kind = _INDEXED if pixels.ndim == 2 else _RGBA
    # Each line starts with the number of its filter; 0 is none.
    lines = np.pad(pixels.reshape(height, -1), ((0, 0), (1, 0)))
    chunks = [_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0))]
    if offsets is not None:
        chunks.append(_chunk(b"grAb", struct.pack(">ii", *offsets)))
    if kind == _INDEXED:
        chunks.append(_chunk(b"PLTE", PALETTE.tobytes()))
    chunks.append(_chunk(b"IDAT", zlib.compress(lines.tobytes())))
    chunks.append(_chunk(b"IEND", b""))
    return _SIGNATURE + b"".join(chunks)
