"""Tables, texts and logs of a run folder."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from torchrl.record.loggers import CSVLogger, Logger, TensorboardLogger

from toponav.runs.atomic import replacing

#: One measurement: names to values.
Figures = Mapping[str, float]


def make_loggers(folder: Path) -> list[Logger]:
    """TorchRL's loggers: ``logs/csv`` (a file a name) and ``logs/tensorboard``.

    A resumed run appends to both.
    """
    logs = str(folder / "logs")
    return [CSVLogger("csv", log_dir=logs), TensorboardLogger("tensorboard", logs)]


def write_history(path: Path, history: Sequence[Figures]) -> None:
    """Write measurements as a CSV table, one row each; the last names the columns."""
    names = list(history[-1])
    cells = [[_to_cell(row.get(name, "")) for name in names] for row in history]
    table = pd.DataFrame(cells, columns=names, dtype=object)
    write_text(path, table.to_csv(index=False, lineterminator="\n"))


def _to_cell(value: float | str) -> float | str:
    """Floats get six digits; NaN becomes an empty cell."""
    if isinstance(value, int | str):
        return value
    return "" if math.isnan(value) else f"{value:.6g}"


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_array(path: Path, values: ArrayLike) -> None:
    """Write a NumPy file atomically."""
    with replacing(path) as temporary:
        np.save(temporary, np.asarray(values), allow_pickle=False)
