"""Files of a run folder, written atomically: checkpoints, tables and logs.

Checkpoints hold tensors and plain values, and are read without running code.
"""

import io
import math
import os
import pickletools
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from numpy.typing import ArrayLike
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from torchrl.record.loggers import CSVLogger, Logger, TensorboardLogger

from toponav.config import SettingsError, require
from toponav.runs.locks import locked
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
# that a key takes to be compared.
_MOST_AGAIN = 16
#: One measurement: names to values.
Figures = Mapping[str, float]


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Give a temporary path in the same folder; on success it replaces ``path``.

    Both have the same suffix. After an error ``path`` is untouched; an ``OSError`` of
    the block names it.

    Examples:
        >>> import tempfile
        >>> with replacing(tempfile.mkdtemp() + "/notes.txt") as temporary:
        ...     _ = temporary.write_text("complete")
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        # The bytes are on disk before the file is renamed.
        with temporary.open("r+b") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        # What fails while it is written, such as on a full disk, names no file, and
        # nobody knows the temporary one.
        unnamed = error.filename is None or str(error.filename) == str(temporary)
        if error.errno is not None and unnamed:
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def remove_halves(folder: Path) -> None:
    """Remove what `replacing` left in a run folder when its process was killed."""
    for inside in ("", "config/", "logs/**/"):
        for path in folder.glob(f"{inside}.*"):
            if re.fullmatch(r"\..+\.\d+\.\w+", path.name):
                path.unlink(missing_ok=True)


def remove_halves_of(path: Path) -> None:
    """Remove what `replacing` left of one file; only its lock's holder may do so."""
    for half in path.parent.glob(f".{path.stem}.*{path.suffix}"):
        if re.fullmatch(rf"\.{re.escape(path.stem)}\.\d+{path.suffix}", half.name):
            half.unlink(missing_ok=True)


@contextmanager
def alone_with(*paths: Path) -> Iterator[None]:
    """Write files of one folder that other processes may write, too: one at a time.

    What killed ones left of them is removed.
    """
    with locked(paths[0].with_name(f".{paths[0].stem}.lock")):
        for path in paths:
            remove_halves_of(path)
        yield


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


def make_loggers(folder: Path, last_step: int) -> list[Logger]:
    """TorchRL's loggers: ``logs/csv`` (a file a name) and ``logs/tensorboard``.

    A resumed run appends to both. Rows after ``last_step``, which it logs again, are
    dropped from the CSV files and hidden in TensorBoard; so are, from the former,
    damaged ones, such as a crash leaves: nothing that the run does depends on them.
    """
    logs = folder / "logs"
    for path in logs.glob("csv/scalars/**/*.csv"):
        # The last row of a process that was killed may have no end.
        *whole, _ = path.read_bytes().decode("utf-8", errors="replace").split("\n")
        kept = [row for row in whole if _step_of(row) <= last_step]
        write_text(path, "".join(f"{row}\n" for row in kept))
    board = TensorboardLogger("tensorboard", str(logs))
    event = Event(step=last_step + 1, session_log=SessionLog(status=SessionLog.START))
    board.experiment.file_writer.add_event(event)
    return [CSVLogger("csv", log_dir=str(logs)), board]


def _step_of(row: str) -> float:
    """The step of a row of a log, infinite if it is no row of two numbers."""
    with suppress(ValueError):
        step, value = row.split(",")
        float(value)
        return int(step)
    return math.inf


def write_history(path: Path, history: Sequence[Figures]) -> None:
    """Write measurements as a CSV table, one row each; the last names the columns."""
    table = pd.DataFrame(list(history), columns=list(history[-1]), dtype=object)
    cells = table.map(_to_cell)
    write_text(path, cells.to_csv(index=False, lineterminator="\n"))


def _to_cell(value: float | str) -> float | str:
    """Floats get six digits; NaN becomes an empty cell."""
    if isinstance(value, int | str):
        return value
    return "" if math.isnan(value) else f"{value:.6g}"


def write_text(path: Path, text: str) -> None:
    """Write a text file."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_array(path: Path, values: ArrayLike) -> None:
    """Write a NumPy file."""
    with replacing(path) as temporary:
        np.save(temporary, np.asarray(values), allow_pickle=False)
