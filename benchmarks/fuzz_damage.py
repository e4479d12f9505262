"""Ways to damage what is written, for the cases of `fuzz`."""

import random
import zipfile
from pathlib import Path


def damage(path: Path, way: str, draw: random.Random) -> None:
    """Flip, cut off or insert bytes of a file, or replace it by text."""
    data = path.read_bytes()
    if way == "flip":
        data = flipped(data, draw, draw.choice([1, 1, 2, 20]))
    elif way == "cut":
        data = data[: draw.randrange(len(data))]
    elif way == "insert":
        at = draw.randrange(len(data))
        data = data[:at] + draw.randbytes(draw.randint(1, 100)) + data[at:]
    else:
        data = draw.choice([b"", b"hello\n", b"\x80\x02.", b"PK\x03\x04", b"{}" * 50])
    path.write_bytes(data)


def flipped(data: bytes, draw: random.Random, times: int) -> bytes:
    """The same with some bits changed."""
    found = bytearray(data)
    for _ in range(times):
        found[draw.randrange(len(found))] ^= 1 << draw.randrange(8)
    return bytes(found)


def rewrite(path: Path, entries: dict[str, bytes]) -> None:
    """The same archive with other entries."""
    with zipfile.ZipFile(path) as archive:
        kept = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in (kept | entries).items():
            archive.writestr(name, data)
