"""`draw_curves`: a training's losses and held-out accuracies in one picture."""

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

# Okabe and Ito's colours, which colour-blind readers can tell apart.
_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9")


def draw_curves(
    history: Sequence[Mapping[str, float]],
    *,
    panels: Mapping[str, Sequence[str]],
    x: str,
    percent: Sequence[str] = (),
    title: str = "",
) -> Figure:
    """Draw figures over the course of a run, one panel beside the other.

    Args:
        history: one mapping of names to values for each measurement, in order.
        panels: the panel's title and the names that it shows; names that the history
            lacks are left out.
        x: name of the horizontal axis.
        percent: titles of the panels whose values are shares.
        title: over the picture.

    Examples:
        >>> history = [{"update": 1, "loss": 0.7}, {"update": 2, "loss": 0.6}]
        >>> figure = draw_curves(history, panels={"Loss": ["loss"]}, x="update")
        >>> len(figure.axes)
        1
    """
    figure = Figure(figsize=(4.2 * len(panels), 3.4), layout="constrained")
    row = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (heading, names) in zip(row, panels.items(), strict=True):
        _draw_panel(axes, history, names, x)
        axes.set_title(heading, loc="left", fontsize=10)
        if heading in percent:
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def _draw_panel(
    axes: Axes, history: Sequence[Mapping[str, float]], names: Sequence[str], x: str
) -> None:
    """Lines of one panel, each with its last value in the legend."""
    shown = [name for name in names if history and name in history[-1]]
    for number, name in enumerate(shown):
        points = [(row[x], row[name]) for row in history if name in row]
        across, up = zip(*points, strict=True)
        axes.plot(
            across,
            up,
            marker="o",
            markersize=3,
            linewidth=1.4,
            color=_COLOURS[number % len(_COLOURS)],
            label=f"{name} {up[-1]:.3f}",
        )
    axes.set_xlabel(x)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    if shown:
        axes.legend(fontsize=7.5, frameon=False)
