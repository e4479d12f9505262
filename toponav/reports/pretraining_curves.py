"""What a pre-training writes while it trains: its measurements and their curves."""

from collections.abc import Sequence
from pathlib import Path

from torchrl.record.loggers import Logger

from toponav.plotting import draw_curves, save_figure
from toponav.runs import Figures, write_history


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


def progress_figures(figures: Figures) -> dict[str, str]:
    """Losses and accuracies for a progress bar."""
    return {
        "loss_tc": f"{figures['loss_tc']:.3f}",
        "loss_l": f"{figures['loss_locomotion']:.3f}",
        "tc": f"{figures['tc_accuracy']:.1%}",
        "l": f"{figures['l_accuracy']:.1%}",
    }


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
    save_figure(figure, path)
