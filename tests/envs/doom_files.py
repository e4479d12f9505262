"""Readers of what the compiler writes, independent of it."""

import re
import struct


def lumps_of(wad: bytes) -> list[tuple[str, bytes]]:
    """Name and content of every lump, in order."""
    kind, number, start = struct.unpack_from("<4sii", wad)
    assert kind == b"PWAD"
    found = []
    for i in range(number):
        offset, size, name = struct.unpack_from("<ii8s", wad, start + 16 * i)
        found.append((name.rstrip(b"\0").decode("ascii"), wad[offset : offset + size]))
    return found


def blocks_of(textmap: str, kind: str) -> list[dict[str, str]]:
    """Keys and values of every block of a kind, e.g. ``linedef``, in order."""
    return [
        dict(entry.split("=") for entry in body.rstrip(";").split(";"))
        for body in re.findall(rf"^{kind}\{{(.*)\}}$", textmap, re.MULTILINE)
    ]
