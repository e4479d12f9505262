"""How an agent came along while it practised: a table and its picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from toponav.plotting import draw_curves, save_figure
from toponav.runs import write_history

_PANELS = {
    "Progress of a decision, in decisions": ["progress"],
    "Targets per 1,000 decisions": ["reached", "given up"],
    "Entropy of the actions": ["entropy"],
    "Share of the edges": ["confirmed", "mistaken"],
}


def write_practice(folder: Path, rows: Sequence[Mapping[str, float]]) -> None:
    """Write ``practice.csv`` and ``practice.png``: a row a batch, by ``decisions``."""
    write_history(folder / "practice.csv", rows)
    save_figure(
        draw_curves(rows, panels=_PANELS, x="decisions"), folder / "practice.png"
    )
