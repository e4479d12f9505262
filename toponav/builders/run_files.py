"""What a training writes into its run folder, beside networks and checkpoints."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from torchrl.record.loggers import CSVLogger, Logger, TensorboardLogger

from toponav.evaluation import draw_curves

#: One measurement: names to values.
Figures = Mapping[str, float]


def make_loggers(folder: Path) -> list[Logger]:
    """TorchRL's loggers: ``logs/csv`` (a file a name) and ``logs/tensorboard``.

    Both go on where an interrupted run stopped.
    """
    logs = str(folder / "logs")
    return [CSVLogger("csv", log_dir=logs), TensorboardLogger("tensorboard", logs)]


def write_measurements(
    folder: Path, loggers: Sequence[Logger], history: Sequence[Figures]
) -> None:
    """Log the last measurement, and write all as ``metrics.csv`` and ``curves.png``.

    Args:
        folder: the run folder.
        loggers: get every figure under ``pretrain/<name>``.
        history: the measurements so far, each with its ``update``.
    """
    last = history[-1]
    named = {f"pretrain/{name}": value for name, value in last.items()}
    for logger in loggers:
        logger.log_metrics(named, step=int(last["update"]))
    write_history(folder / "metrics.csv", history)
    write_curves(folder / "curves.png", history)


def write_history(path: Path, history: Sequence[Figures]) -> None:
    r"""Write measurements as one table, a row each, whole or not at all.

    Args:
        path: the CSV file.
        history: the measurements; the last one names the columns.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "metrics.csv"
        >>> write_history(path, [{"update": 1, "loss": 0.75}])
        >>> path.read_text().split()
        ['update,loss', '1,0.75']
    """
    text = io.StringIO()
    names = list(history[-1])
    table = csv.DictWriter(text, names, extrasaction="ignore", lineterminator="\n")
    table.writeheader()
    for row in history:
        table.writerow({name: _in_table(value) for name, value in row.items()})
    write_text(path, text.getvalue())


def _in_table(value: float | str) -> float | str:
    """Nothing for a number that is none; six digits are enough for the others."""
    if isinstance(value, int | str):
        return value
    return "" if math.isnan(value) else f"{value:.6g}"


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    fresh = path.with_name(f".{path.name}.new")
    fresh.write_text(text, encoding="utf-8")
    fresh.replace(path)


def write_curves(path: Path, history: Sequence[Figures]) -> None:
    """Draw the accuracy on held-out episodes and the losses over the updates."""
    offsets = sorted(name for name in history[-1] if name.startswith("l_accuracy_"))
    figure = draw_curves(
        history,
        x="update",
        panels={
            "TC-network, held out": [
                "tc_accuracy",
                "tc_accuracy_k4_m5",
                "tc_positives",
                "tc_negatives",
                "tc_auc",
            ],
            "L-network, held out, by offset": offsets,
            "Losses": ["loss_tc", "loss_locomotion"],
        },
        percent=["TC-network, held out", "L-network, held out, by offset"],
    )
    figure.savefig(path, dpi=150)
