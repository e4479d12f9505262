"""Files of a run folder, written atomically: tables and logs."""

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from torchrl.record.loggers import CSVLogger, Logger, TensorboardLogger

from toponav.runs.locks import locked

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
