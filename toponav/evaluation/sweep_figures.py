"""The figure of a sweep: learning curves of explorers, accuracies of networks.

- `draw_learning_curves`: coverage over the training, a line and a band a group.
- `draw_accuracies`: values over a swept setting, a dot a run.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator
from numpy.typing import NDArray

from toponav.evaluation.statistics import Floats

# Okabe and Ito's colours, which colour-blind readers can tell apart, and marks for
# those who see none.
_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9")
_MARKS = "os^Dvp"
_GREY = "#6b6b6b"
# Ends of the lines that mark a level: dotted, dashed, and so on.
_DASHES = (":", "--", "-.")
_GRID = 200


@dataclass(frozen=True)
class Curve:
    """The curves of a group of runs.

    Args:
        label: what the legend calls the group.
        runs: of each run the decisions, ascending, and the values, ``[N]`` each.
    """

    label: str
    runs: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]

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
    """Draw the mean of each group of runs and a band from its least to its best run.

    Args:
        panels: the groups of each panel, by the panel's title.
        levels: by panel, values to mark with a line across it, by name.
        label: of the vertical axis.
        title: over the picture.

    Returns:
        A figure with no window; ``savefig`` writes it.

    Examples:
        >>> x, y = np.arange(3.0), np.array([40.0, 60.0, 80.0])
        >>> curve = Curve("alpha 0.2", [(x, y), (x, y + 10)])
        >>> figure = draw_learning_curves(
        ...     {"maze3": [curve]}, {"maze3": {"random": 42.0}}, label="coverage (%)"
        ... )
        >>> [line.get_label() for line in figure.axes[0].lines]
        ['alpha 0.2 (2 runs)', 'random 42.0']
    """
    figure, grid = _panels(len(panels))
    for axes, (heading, curves) in zip(grid, panels.items(), strict=False):
        for number, curve in enumerate(curves):
            colour = _COLOURS[number % len(_COLOURS)]
            x, middle, low, high = curve.band()
            count = f"{len(curve.runs)} run{'s' * (len(curve.runs) > 1)}"
            name = f"{curve.label} ({count})" if curve.label else count
            axes.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)
            axes.plot(x, middle, color=colour, linewidth=1.8, label=name)
        marked = levels.get(heading, {})
        for number, (name, value) in enumerate(marked.items()):
            axes.axhline(
                value,
                color=_GREY,
                linestyle=_DASHES[number % len(_DASHES)],
                linewidth=1.3,
                label=f"{name} {value:.1f}",
            )
        _dress(axes, heading, "decisions of the training", label)
        axes.set_xlim(left=0)
        axes.set_ylim(0, 102)
        axes.xaxis.set_major_formatter(FuncFormatter(thousands))
        axes.legend(
            title="line: mean, band: worst to best run",
            title_fontsize=7.5,
            alignment="left",
            fontsize=7.5,
            frameon=False,
            loc="lower right",
        )
    if title:
        figure.suptitle(title, fontsize=10)
    return figure


def draw_accuracies(
    panels: Mapping[str, Mapping[str, Sequence[tuple[str, Sequence[float]]]]],
    *,
    x: str,
    label: str,
    title: str = "",
) -> Figure:
    """Draw values over a swept setting: a dot a run, and their means.

    Settings that are numbers keep their distances, on a logarithmic axis if they span
    more than a factor of ten; others stand side by side and without a line.

    Args:
        panels: by the panel's title and the line's name, the values of the runs at
            each value of the setting.
        x: name of the setting.
        label: of the vertical axis.
        title: over the picture.

    Returns:
        A figure with no window; ``savefig`` writes it.

    Examples:
        >>> points = [("2", [81.0, 83.0]), ("4", [92.0])]
        >>> figure = draw_accuracies(
        ...     {"select": {"TC": points}}, x="pairs.k", label="accuracy (%)"
        ... )
        >>> figure.axes[0].lines[0].get_ydata().tolist()
        [82.0, 92.0]
    """
    figure, grid = _panels(len(panels))
    for axes in grid[1:]:
        axes.sharey(grid[0])
    for axes, (heading, lines) in zip(grid, panels.items(), strict=False):
        names = list(dict.fromkeys(at for points in lines.values() for at, _ in points))
        places = _places(names)
        for number, (name, points) in enumerate(lines.items()):
            colour = _COLOURS[number % len(_COLOURS)]
            across = [places[at] for at, _ in points]
            means = [float(np.mean(values)) for _, values in points]
            mark = _MARKS[number % len(_MARKS)]
            count = max(len(values) for _, values in points)
            axes.plot(
                across,
                means,
                marker=mark,
                markersize=5,
                # Between names there is nothing that a line could show.
                linestyle="-" if _are_numbers(names) else "",
                color=colour,
                label=f"{name}, mean of {count} run{'s' * (count > 1)}",
            )
            if count > 1:
                for at, values in points:
                    across_all = [places[at]] * len(values)
                    axes.scatter(
                        across_all, values, s=14, c=colour, marker=mark, alpha=0.35
                    )
        _dress(axes, heading, x, label)
        if _is_wide(places.values()):
            axes.set_xscale("log")
            axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(list(places.values()), names)
        if max(map(len, names)) * len(names) > 40:
            axes.tick_params(axis="x", labelrotation=30)
        axes.legend(fontsize=7.5, frameon=False)
    if title:
        figure.suptitle(title, fontsize=10)
    return figure


def thousands(value: float, _position: int | None = None) -> str:
    """A number of decisions for an axis.

    Examples:
        >>> thousands(0), thousands(150_000), thousands(2_500_000)
        ('0', '150 k', '2.5 M')
    """
    if abs(value) >= 1e6:
        return f"{value / 1e6:g} M"
    return f"{value / 1e3:g} k" if abs(value) >= 1e3 else f"{value:g}"


def _places(names: Sequence[str]) -> dict[str, float]:
    """Where each value of a setting stands: at itself, if all are numbers."""
    if _are_numbers(names):
        return {name: float(name) for name in names}
    # From 0, so that no axis of names is logarithmic.
    return {name: float(number) for number, name in enumerate(names)}


def _are_numbers(names: Sequence[str]) -> bool:
    try:
        return bool([float(name) for name in names])
    except ValueError:
        return False


def _is_wide(places: Collection[float]) -> bool:
    """Whether a logarithmic axis shows the places better."""
    return min(places) > 0 and max(places) > 10 * min(places)


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    columns = min(max(count, 1), 3)
    rows = max(1, math.ceil(count / columns))
    wide = 6.4 if columns == 1 else 4.6 * columns
    figure = Figure(figsize=(wide, 3.8 * rows), layout="constrained")
    grid = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in grid[count:]:
        axes.remove()
    return figure, grid[:count]


def _dress(axes: Axes, heading: str, x: str, y: str) -> None:
    axes.set_title(heading, loc="left", fontsize=10)
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.25)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
