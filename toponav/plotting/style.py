"""The style of all figures, and saving them."""

import textwrap
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator, NullLocator, PercentFormatter

from toponav.runs import replacing

# Okabe and Ito's colours, which colour-blind readers can tell apart; marks and dashes
# are for readers who see no colours at all.
BLUE, ORANGE, GREEN, RED = "#0072b2", "#e69f00", "#009e73", "#d55e00"
PINK, SKY, YELLOW = "#cc79a7", "#56b4e9", "#f0e442"
INK, GREY, PALE, WHITE = "#22252a", "#6b6b6b", "#d9dadc", "#ffffff"
PALETTE = (BLUE, ORANGE, GREEN, RED, PINK, SKY)
MARKS = "os^Dvp"
DASHES = ("-", "--", ":", "-.")

CENTRED: dict[str, Any] = {"ha": "center", "va": "center"}
TITLE, HEADING, TEXT, SMALL = 11.0, 10.0, 8.5, 7.5
LINE, THIN = 1.8, 1.2
LEGEND: dict[str, Any] = {"fontsize": SMALL, "title_fontsize": SMALL}
LEGEND |= {"alignment": "left", "frameon": False}
#: Characters of a legend below a panel to an inch of the panel, which a wider legend
#: would push aside.
_TO_AN_INCH = 16.5
_DRAWING = Lock()


def new_figure(width: float, height: float, *, title: str = "") -> Figure:
    """A figure in inches without a window; `save_figure` writes it."""
    figure = Figure(figsize=(width, height), layout="constrained", dpi=110)
    if title:
        figure.suptitle(title, fontsize=TITLE, color=INK)
    return figure


def add_heading(axes: Axes, text: str) -> None:
    """Put a title over the left end of a panel."""
    axes.set_title(text, loc="left", fontsize=HEADING)


def finish(
    axes: Axes,
    *,
    title: str = "",
    x: str = "",
    y: str = "",
    legend: Any = "best",
    note: str | None = None,
    empty: str = "nothing to show",
) -> None:
    """Finish a panel: its title, labels ``x`` and ``y``, a light grid, no box.

    What it shows is named where ``legend`` says, under ``note``; not with ``None``, and
    with ``"below"`` in two columns below it, where it hides nothing (in one, and in
    several rows each, if names are long). ``empty`` says why a panel shows nothing.
    """
    if title:
        add_heading(axes, title)
    axes.set_xlabel(x, fontsize=TEXT)
    axes.set_ylabel(y, fontsize=TEXT)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    handles, names = axes.get_legend_handles_labels()
    if legend and handles:
        place: dict[str, Any] = {"loc": legend}
        if legend == "below":
            row = int(_TO_AN_INCH * axes.bbox.width / axes.figure.dpi)
            columns = 2 if max(map(len, names)) <= row // 2 else 1
            names = [textwrap.fill(name, row // columns) for name in names]
            place = {"loc": "upper left", "bbox_to_anchor": (0, -0.14)}
            place["ncols"] = columns
        axes.legend(handles, names, title=note, **place, **LEGEND)
    elif legend:
        look: dict[str, Any] = {"size": TEXT, "color": GREY, **CENTRED}
        axes.text(0.5, 0.5, empty, transform=axes.transAxes, **look)


def add_legend_below(axes: Axes, distance: float = 0.08) -> None:
    """Name what a plan shows in rows below it."""
    look: dict[str, Any] = {"fontsize": TEXT, "frameon": False, "labelcolor": INK}
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -distance), ncols=4, **look)


def add_levels(axes: Axes, levels: dict[str, float]) -> None:
    """Mark values with dashed lines across a panel; the keys are their labels."""
    for number, (label, level) in enumerate(levels.items()):
        dashes = (":", "--", "-.")[number % 3]
        axes.axhline(level, color=GREY, linestyle=dashes, linewidth=THIN, label=label)


def add_dots(
    axes: Axes, places: np.ndarray, size: float, label: str, **style: Any
) -> None:
    """Dots at ``[N, 2]``."""
    look: dict[str, Any] = {"c": WHITE, "edgecolors": INK, "linewidths": 0.6}
    x, y = places[:, :2].T
    axes.scatter(x, y, s=size, label=label, **{"zorder": 5, **look, **style})


def add_lines(
    axes: Axes, ends: np.ndarray, colour: str, width: float, **style: Any
) -> None:
    """Straight lines between points, ``[N, 2, 2]``."""
    look: dict[str, Any] = {"colors": colour, "linewidths": width, "alpha": 0.8}
    axes.add_collection(LineCollection(list(ends), **{"zorder": 3, **look, **style}))


def show_percent(axes: Axes) -> None:
    """Show the vertical axis, of shares in [0, 1], in percent."""
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def show_thousands(axes: Axes, *, log: bool = False) -> None:
    """Show the horizontal axis, of decisions, such as 150 k or 2.5 M.

    It begins at 0, or is logarithmic.
    """
    if log:
        axes.set_xscale("log")
        axes.xaxis.set_minor_locator(NullLocator())
    else:
        axes.set_xlim(left=0)
        axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.xaxis.set_major_formatter(EngFormatter(sep=" "))


def save_figure(figure: Figure, path: Path | str, *, dpi: float = 120) -> None:
    """Write a picture; a killed process leaves the old file or the new one."""
    # matplotlib is for one thread at a time.
    with replacing(path) as temporary, _DRAWING:
        figure.savefig(temporary, dpi=dpi)
