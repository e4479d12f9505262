"""Figures of a sweep: learning curves, and values over a swept setting."""

import math
from collections.abc import Mapping, Sequence
from itertools import cycle, product

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from toponav.metrics import Floats
from toponav.plotting import style

_BAND = "line: mean, band: worst to best run"


#: Of each run of a group the decisions, ascending, and the values, ``[N]``.
Runs = Sequence[tuple[Floats, Floats]]


def band(runs: Runs) -> tuple[Floats, Floats, Floats, Floats]:
    """Decisions that all runs cover, and there mean, least and largest value."""
    known = [(x[np.isfinite(y)], y[np.isfinite(y)]) for x, y in runs]
    known = [(x, y) for x, y in known if len(x)]
    if not known:
        return (np.empty(0),) * 4
    first = max(x[0] for x, _ in known)
    last = min(x[-1] for x, _ in known)
    if all(np.array_equal(x, known[0][0]) for x, _ in known):
        grid = known[0][0]
    else:
        grid = np.linspace(first, last, 200) if first <= last else np.empty(0)
    values = np.stack([np.interp(grid, x, y) for x, y in known])
    return grid, values.mean(0), values.min(0), values.max(0)


def draw_learning_curves(
    panels: Mapping[str, Mapping[str, Runs]],
    levels: Mapping[str, Mapping[str, float]],
    *,
    label: str,
    title: str = "",
    x: str = "decisions of the training",
    log_x: bool = False,
    percent: bool = True,
) -> Figure:
    """Draw the mean of each group of runs and a band from its worst to its best run.

    Groups are by panel and name, and so are ``levels``, values to mark with a line
    across; ``label`` stands at the vertical axis, which ends at 0 and 100 if values are
    in ``percent``, and ``x`` at the other, which is logarithmic with ``log_x``.

    Examples:
        >>> x, y = np.arange(3.0), np.array([40.0, 60.0, 80.0])
        >>> panels = {"maze3": {"alpha 0.2": [(x, y), (x, y + 10)]}}
        >>> figure = draw_learning_curves(panels, {}, label="coverage (%)")
        >>> [line.get_label() for line in figure.axes[0].lines]
        ['alpha 0.2 (2 runs)']
    """
    figure, grid = _new_grid(len(panels), title)
    for axes, (heading, groups) in zip(grid, panels.items(), strict=True):
        looks = cycle(product(style.DASHES, style.PALETTE))
        for (name, runs), (dashes, colour) in zip(groups.items(), looks, strict=False):
            at, middle, low, high = band(runs)
            drawn = sum(bool(np.isfinite(values).any()) for _, values in runs)
            count = f"{drawn} run{'s' * (drawn != 1)}"
            name = f"{name} ({count})" if name else count
            axes.fill_between(at, low, high, color=colour, alpha=0.18, linewidth=0)
            axes.plot(at, middle, dashes, c=colour, lw=style.LINE, label=name)
        marked = levels.get(heading, {})
        style.add_levels(axes, {f"{name} {of:.1f}": of for name, of in marked.items()})
        if percent:
            axes.set_ylim(0, 102)
        style.show_thousands(axes, log=log_x)
        labels = {"x": x, "y": label, "note": _BAND}
        style.finish(axes, title=heading, legend="below", **labels)
    return figure


def draw_sweep(
    values: pd.DataFrame, *, x: str, label: str, title: str = "", same_y: bool = True
) -> Figure:
    """Draw values over a swept setting: a dot a run, and their means.

    Numbers that span more than a factor of ten get a logarithmic axis. ``values`` has
    a row a run: ``panel`` and ``line`` (their names), ``at`` (the setting ``x``, as
    text) and ``value``; ``label`` stands at the vertical axis, which all panels have
    in common if ``same_y``.

    Examples:
        >>> rows = [("", "TC", "2", 81.0), ("", "TC", "2", 83.0), ("", "TC", "4", 92.0)]
        >>> values = pd.DataFrame(rows, columns=["panel", "line", "at", "value"])
        >>> figure = draw_sweep(values, x="pairs.k", label="accuracy (%)")
        >>> figure.axes[0].lines[0].get_ydata().tolist()
        [82.0, 92.0]
    """
    panels = values.groupby("panel", sort=False)
    figure, grid = _new_grid(len(panels), title)
    for axes in grid[1:] if same_y else ():
        axes.sharey(grid[0])
    for axes, (heading, panel) in zip(grid, panels, strict=True):
        names = panel["at"].unique()
        places = pd.to_numeric(pd.Series(names, index=names), errors="coerce")
        # Between names there is nothing that a line could show.
        dashes = "-" if places.notna().all() else ""
        if not dashes:
            # From 0, so that no axis of names is logarithmic.
            places[:] = range(len(names))
        looks = zip(cycle(style.PALETTE), cycle(style.MARKS), strict=False)
        lines = panel.groupby("line", sort=False)
        for (line, runs), (colour, mark) in zip(lines, looks, strict=False):
            points = runs.groupby("at", sort=False)["value"].agg(["mean", "size"])
            fewest, count = int(points["size"].min()), int(points["size"].max())
            several = f"{fewest} to {count}" if fewest < count else f"{count}"
            name = f"{line}, mean of {several} run{'s' * (count > 1)}"
            at, mean = places[points.index], points["mean"]
            axes.plot(at, mean, mark, c=colour, ls=dashes, ms=5, label=name)
            if count > 1:
                at, value = runs["at"].map(places), runs["value"]
                axes.scatter(at, value, 14, colour, marker=mark, alpha=0.35)
        style.finish(axes, title=str(heading), x=x, y=label)
        if 0 < 10 * places.min() < places.max():
            axes.set_xscale("log")
            axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(places, names)
        if max(map(len, names)) * len(names) > 40:
            axes.tick_params(axis="x", labelrotation=30)
    return figure


def _new_grid(count: int, title: str) -> tuple[Figure, list[Axes]]:
    """Panels in rows of up to three."""
    columns = min(max(count, 1), 3)
    rows = max(1, math.ceil(count / columns))
    width = 6.4 if columns == 1 else 4.6 * columns
    figure = style.new_figure(width, 3.8 * rows, title=title)
    grid = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in grid[count:]:
        axes.remove()
    return figure, grid[:count]
