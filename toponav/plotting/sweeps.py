"""Figures of a sweep: learning curves, and values over a swept setting."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from toponav.metrics import Floats
from toponav.plotting.style import (
    LINE,
    MARKS,
    PALETTE,
    add_legend,
    add_levels,
    new_figure,
    show_thousands,
    style_axes,
)

_GRID = 200


@dataclass(frozen=True)
class Curve:
    """A group of runs: of each the decisions, ascending, and the values, ``[N]``."""

    label: str
    runs: Sequence[tuple[Floats, Floats]]

    def band(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Decisions that all runs cover, and there mean, least and largest value."""
        known = [(x[np.isfinite(y)], y[np.isfinite(y)]) for x, y in self.runs]
        known = [(x, y) for x, y in known if len(x)]
        if not known:
            return (np.empty(0),) * 4
        first = max(x[0] for x, _ in known)
        last = min(x[-1] for x, _ in known)
        grid = np.linspace(first, last, _GRID) if first <= last else np.empty(0)
        values = np.stack([np.interp(grid, x, y) for x, y in known])
        return grid, values.mean(0), values.min(0), values.max(0)


def draw_learning_curves(
    panels: Mapping[str, Sequence[Curve]],
    levels: Mapping[str, Mapping[str, float]],
    *,
    label: str,
    title: str = "",
) -> Figure:
    """Draw the mean of each group of runs and a band from its worst to its best run.

    Args:
        panels: the groups of each panel, by the panel's title.
        levels: by panel, values to mark with a line across it, by name.
        label: of the vertical axis.
        title: over the picture.

    Examples:
        >>> x, y = np.arange(3.0), np.array([40.0, 60.0, 80.0])
        >>> curve = Curve("alpha 0.2", [(x, y), (x, y + 10)])
        >>> figure = draw_learning_curves(
        ...     {"maze3": [curve]}, {"maze3": {"random": 42.0}}, label="coverage (%)"
        ... )
        >>> [line.get_label() for line in figure.axes[0].lines]
        ['alpha 0.2 (2 runs)', 'random 42.0']
    """
    figure, grid = _new_grid(len(panels), title)
    for axes, (heading, curves) in zip(grid, panels.items(), strict=True):
        for number, curve in enumerate(curves):
            colour = PALETTE[number % len(PALETTE)]
            x, middle, low, high = curve.band()
            count = f"{len(curve.runs)} run{'s' * (len(curve.runs) > 1)}"
            name = f"{curve.label} ({count})" if curve.label else count
            axes.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)
            axes.plot(x, middle, color=colour, linewidth=LINE, label=name)
        marked = levels.get(heading, {})
        add_levels(axes, {f"{name} {at:.1f}": at for name, at in marked.items()})
        style_axes(axes, title=heading, x="decisions of the training", y=label)
        axes.set_xlim(left=0)
        axes.set_ylim(0, 102)
        show_thousands(axes)
        add_legend(axes, title="line: mean, band: worst to best run", loc="lower right")
    return figure


def draw_sweep(values: pd.DataFrame, *, x: str, label: str, title: str = "") -> Figure:
    """Draw values over a swept setting: a dot a run, and their means.

    Numbers that span more than a factor of ten get a logarithmic axis.

    Args:
        values: a row a run, with the columns ``panel`` and ``line`` (their names),
            ``at`` (the setting, as text) and ``value``.
        x: name of the setting.
        label: of the vertical axis.
        title: over the picture.

    Examples:
        >>> rows = [("", "TC", "2", 81.0), ("", "TC", "2", 83.0), ("", "TC", "4", 92.0)]
        >>> values = pd.DataFrame(rows, columns=["panel", "line", "at", "value"])
        >>> figure = draw_sweep(values, x="pairs.k", label="accuracy (%)")
        >>> figure.axes[0].lines[0].get_ydata().tolist()
        [82.0, 92.0]
    """
    panels = values.groupby("panel", sort=False)
    figure, grid = _new_grid(len(panels), title)
    for axes in grid[1:]:
        axes.sharey(grid[0])
    for axes, (heading, panel) in zip(grid, panels, strict=True):
        names = list(panel["at"].unique())
        numbers = pd.to_numeric(pd.Series(names), errors="coerce")
        are_numbers = bool(numbers.notna().all())
        if not are_numbers:
            # From 0, so that no axis of names is logarithmic.
            numbers = pd.Series(range(len(names)))
        places = dict(zip(names, numbers, strict=True))
        for number, (line, runs) in enumerate(panel.groupby("line", sort=False)):
            look: dict[str, Any] = {
                "color": PALETTE[number % len(PALETTE)],
                "marker": MARKS[number % len(MARKS)],
            }
            means = runs.groupby("at", sort=False)["value"].mean()
            count = int(runs.groupby("at").size().max())
            axes.plot(
                [places[at] for at in means.index],
                means,
                markersize=5,
                # Between names there is nothing that a line could show.
                linestyle="-" if are_numbers else "",
                label=f"{line}, mean of {count} run{'s' * (count > 1)}",
                **look,
            )
            if count > 1:
                at = runs["at"].map(places)
                axes.scatter(at, runs["value"], s=14, alpha=0.35, **look)
        style_axes(axes, title=str(heading), x=x, y=label)
        if 0 < 10 * numbers.min() < numbers.max():
            axes.set_xscale("log")
            axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(list(places.values()), names)
        if max(map(len, names)) * len(names) > 40:
            axes.tick_params(axis="x", labelrotation=30)
        add_legend(axes)
    return figure


def _new_grid(count: int, title: str) -> tuple[Figure, list[Axes]]:
    """Panels in rows of up to three."""
    columns = min(max(count, 1), 3)
    rows = max(1, math.ceil(count / columns))
    width = 6.4 if columns == 1 else 4.6 * columns
    figure = new_figure(width, 3.8 * rows, title=title)
    grid = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in grid[count:]:
        axes.remove()
    return figure, grid[:count]
