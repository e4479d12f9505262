"""Files of tensors and plain values: written atomically, read without running code.

What is read may be damaged, or made by someone to do harm: it is looked at first.
"""

import io
import pickletools
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import Any

import torch

from toponav.config import SettingsError, require
from toponav.runs.files import replacing
from toponav.runs.weights import not_finite

#: The file in a run folder from which a run is resumed.
CHECKPOINT_FILE = "checkpoint.pt"
# What `save_atomically` writes names these alone, and earlier versions the last two.
_NAMES = re.compile(
    r"collections OrderedDict|torch\._utils _rebuild_tensor_v2|torch [A-Z]\w+Storage"
    r"|torch Size|torch device"
)
# Containers inside each other: runs have 9 at most.
_DEEPEST = 30
# Places in which a tuple stands again, where runs have none: each may double the time
# that a key takes to be hashed.
_MOST_AGAIN = 16


def save_atomically(state: dict[str, object], path: Path) -> None:
    """Write tensors and plain values as one file."""
    # By way of memory: a signal in the middle of a write to a file would reach its
    # caller as an error of PyTorch's writer.
    written = io.BytesIO()
    torch.save(state, written)
    with replacing(path) as temporary:
        temporary.write_bytes(written.getbuffer())


@contextmanager
def reading_checkpoint(
    path: Path,
    setting: str,
    header: Mapping[str, object],
    noun: str,
) -> Iterator[dict[str, Any]]:
    """What `save_atomically` wrote, to make something of it in the ``with`` block.

    The errors name the ``setting`` that named the file and, by a ``noun``, what it
    holds; ``header`` has its ``kind`` and ``version``. Tensors lie on the processor:
    what they are loaded into copies them to its own device.

    Raises:
        SettingsError: if the file is missing, damaged or of another kind or version, or
            if what the block makes of it does not fit.
    """
    require(path.is_file(), f"{setting} must name a run with {path.name}", path)
    try:
        room = _require_own(path)
        found = torch.load(path, map_location="cpu", weights_only=True)
        _require_tree(found, room)
        wrong = next(not_finite(found), None)
    except Exception as bad:  # damage can make any of the readers fail in any way
        raise SettingsError(
            f"{setting} must name a complete file, got the damaged "
            f"{path} ({reason_of(bad)})"
        ) from bad
    rule, given = f"{setting} must name a file of this package", type(found).__name__
    require(type(found) is dict, rule, f"{path} with a {given}")
    rule = f"{setting} must name {noun} of version {header['version']}"
    words = [_word(found.get(key, "")) for key in header]
    given = " ".join(" ".join(words).split())[:80] or "something else"
    require(words == list(map(str, header.values())), rule, f"{path} with {given}")
    rule = f"{setting} must name {noun} whose weights are all finite numbers"
    require(wrong is None, rule, f"{path} with {wrong}")
    try:
        yield found
    except SettingsError:
        raise
    except Exception as bad:  # whatever does not fit
        raise SettingsError(
            f"{setting} must name {noun} saved with the same settings, got {path} "
            f"({reason_of(bad)})"
        ) from bad


def _require_own(path: Path) -> int:
    """Refuse what `save_atomically` does not write; returns the bytes of its pickles.

    Raises:
        ValueError: if its checksums do not fit, or it makes other than tensors and
            values, such as a bytearray, which a few bytes may ask to have gigabytes.
    """
    size = 0
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        stored = all(not entry.compress_type for entry in entries)
        # torch reads a file that begins otherwise as one of its old format.
        whole = any(entry.header_offset == 0 for entry in entries)
        # torch itself does not compare the checksums that it writes.
        if not (stored and whole) or archive.testzip() is not None:
            raise ValueError("its checksums do not fit its content")
        for entry in entries:
            if entry.filename.endswith(".pkl"):
                content = archive.read(entry)
                size += len(content)
                _require_plain_pickle(content)
    return size


def _require_plain_pickle(pickled: bytes) -> None:
    """Refuse a pickle that calls anything but what makes tensors, or takes long."""
    tuples, again, made = set[object](), 0, ""
    for code, given, _ in pickletools.genops(pickled):
        if code.name == "GLOBAL" and not _NAMES.fullmatch(str(given)):
            raise ValueError(f"with {given}, which no run writes")
        if not code.name.endswith("PUT"):
            made = code.name
        elif made.startswith("TUPLE"):
            tuples.add(given)
        again += code.name.endswith("GET") and given in tuples
        if again > _MOST_AGAIN:
            raise ValueError("with tuples inside each other again and again")


def _require_tree(found: object, room: int) -> None:
    """Refuse what nobody could walk through or print: a container inside itself.

    One that stands in many places counts in each. There is ``room`` for as many entries
    as there are bytes, of which each takes one at least.
    """
    level = [found]
    for _ in range(_DEEPEST):
        level = list(islice(chain.from_iterable(map(_inside, level)), room + 1))
        room -= len(level)
        if not level or room < 0:
            break
    if level:
        raise ValueError("with entries inside each other without an end")


def _inside(entry: object) -> Iterable[object]:
    """What a container holds directly."""
    if isinstance(entry, Mapping):
        return chain(entry.keys(), entry.values())
    return entry if isinstance(entry, list | tuple | set) else ()


def _word(value: object) -> str:
    """A word or number as it is; of anything else, what it is."""
    plain = isinstance(value, str | int | float)
    return str(value) if plain else type(value).__name__


def reason_of(error: Exception) -> str:
    r"""The beginning of what an error says, in one line.

    Examples:
        >>> reason_of(ValueError("no header\nbut this"))
        'no header'
    """
    if isinstance(error, KeyError):
        return f"without {error}"[:80]
    return (str(error).strip() or "empty").splitlines()[0][:80]
