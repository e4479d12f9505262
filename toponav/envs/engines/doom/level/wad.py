"""The WAD container: header, contents, directory of (start, size, name)."""

import struct
from collections.abc import Sequence


def build_wad(lumps: Sequence[tuple[str, bytes]]) -> bytes:
    """Pack lumps, pairs of name and content, into a patch WAD in the given order.

    Raises:
        ValueError: if a name is longer than eight characters.

    Examples:
        >>> wad = build_wad([("ONE", b"abc"), ("TWO", b"")])
        >>> struct.unpack("<4sii", wad[:12]), lump_names(wad)
        ((b'PWAD', 2, 15), ['ONE', 'TWO'])
    """
    directory = contents = b""
    header_size = 12
    for name, content in lumps:
        encoded = name.encode("ascii")
        if len(encoded) > 8:
            raise ValueError(f"a lump name must have at most 8 letters, got '{name}'")
        start = header_size + len(contents)
        directory += struct.pack("<ii8s", start, len(content), encoded)
        contents += content
    start = header_size + len(contents)
    return struct.pack("<4sii", b"PWAD", len(lumps), start) + contents + directory


def lump_names(wad: bytes) -> list[str]:
    """Names of a WAD's lumps, in order.

    Raises:
        ValueError: if the bytes are not a whole WAD.
    """
    try:
        kind, number, start = struct.unpack_from("<4sii", wad)
        if kind not in (b"PWAD", b"IWAD"):
            raise ValueError(f"a WAD must begin with PWAD or IWAD, got {kind!r}")
        names = [
            struct.unpack_from("<8x8s", wad, start + 16 * i)[0] for i in range(number)
        ]
        return [name.rstrip(b"\0").decode("ascii") for name in names]
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"a WAD must be whole, got {error}") from None
