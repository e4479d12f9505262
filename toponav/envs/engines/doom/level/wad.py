"""The WAD container: header, contents, directory of (start, size, name)."""

import struct
from collections.abc import Sequence

_HEADER_SIZE = 12


def build_wad(lumps: Sequence[tuple[str, bytes]]) -> bytes:
    """Pack lumps, pairs of name (at most 8 letters) and content, into a patch WAD."""
    directory = contents = b""
    for name, content in lumps:
        if len(name) > 8:
            raise ValueError(f"a lump name must have at most 8 letters, got '{name}'")
        start = _HEADER_SIZE + len(contents)
        directory += struct.pack("<ii8s", start, len(content), name.encode("ascii"))
        contents += content
    start = _HEADER_SIZE + len(contents)
    return struct.pack("<4sii", b"PWAD", len(lumps), start) + contents + directory


def lump_names(wad: bytes) -> list[str]:
    """Names of a WAD's lumps, in order; none if the bytes are not a whole WAD."""
    try:
        kind, number, start = struct.unpack_from("<4sii", wad)
        entries = [
            struct.unpack_from("<8x8s", wad, start + 16 * i) for i in range(number)
        ]
        names = [name.rstrip(b"\0").decode("ascii") for (name,) in entries]
    except (struct.error, UnicodeDecodeError):
        return []
    return names if kind == b"PWAD" else []
