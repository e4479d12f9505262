"""`draw_training`: what an explorer's training has come to so far."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter
from numpy.typing import ArrayLike, NDArray

from toponav.evaluation.diagnostics import correlation
from toponav.evaluation.statistics import running_mean
from toponav.evaluation.sweep_figures import thousands

# Okabe and Ito's colours, which colour-blind readers can tell apart.
_BLUE, _ORANGE, _GREEN, _RED = "#0072b2", "#e69f00", "#009e73", "#d55e00"
_GREY = "#6b6b6b"
_DASHES = (":", "--", "-.")
_DASHED = "--"

#: Names of columns to their values, in the order of the training.
Columns = Mapping[str, ArrayLike]

# Small panels: the title, the table, and the columns with their names in the legend.
_SMALL: tuple[tuple[str, str, dict[str, str]], ...] = (
    (
        "Waypoints per episode",
        "episodes",
        {"births": "births", "false_births": "of them false"},
    ),
    ("Entropy of the policy", "metrics", {"entropy": "entropy"}),
    (
        "Losses of the policy",
        "metrics",
        {"loss_objective": "objective", "loss_critic": "critic"},
    ),
    (
        "Losses of the networks",
        "metrics",
        {"loss_tc": "TC", "loss_locomotion": "L"},
    ),
)


def draw_training(
    episodes: Columns,
    metrics: Columns,
    *,
    levels: Mapping[str, float],
    window: int = 16,
    title: str = "",
) -> Figure:
    """Draw coverage and return of every episode, and what the learner reports.

    Works from the first episode on; what is not there yet is left out.

    Args:
        episodes: columns of ``episodes.csv``: ``decisions``, ``coverage`` in [0, 1],
            ``intrinsic_return``, and those of its parts, ``births``,
            ``false_births``, ``[N]`` each; NaN where there is none.
        metrics: columns of ``metrics.csv``: ``decisions``, ``entropy``,
            ``loss_objective``, ``loss_critic``, ``loss_tc``, ``loss_locomotion``,
            ``networks_version``: where it changes, the rewards' scale may change.
        levels: coverage in [0, 1] to mark with a line, by name, such as that of a
            uniformly random walk.
        window: episodes in the running means.
        title: over the picture.

    Returns:
        A figure of 12 x 6.8 inches, with no window; ``savefig`` writes it.

    Examples:
        >>> episodes = {"decisions": [1800, 3600], "coverage": [0.4, 0.5]}
        >>> figure = draw_training(episodes, {}, levels={"uniform random": 0.42})
        >>> [line.get_label() for line in figure.axes[0].lines]
        ['episodes', 'mean of the last 16', 'uniform random 42%']
    """
    figure = Figure(figsize=(12, 6.8), layout="constrained")
    grid = figure.add_gridspec(2, 4, height_ratios=[1.5, 1.0])
    seen, told = _columns(episodes), _columns(metrics)
    _draw_coverage(figure.add_subplot(grid[0, :2]), seen, levels, window)
    _draw_return(figure.add_subplot(grid[0, 2:]), seen, told, window)
    for number, (heading, table, names) in enumerate(_SMALL):
        axes = figure.add_subplot(grid[1, number])
        _draw_small(axes, seen if table == "episodes" else told, names, window)
        if table == "episodes":
            axes.set_ylim(bottom=0)
        _dress(axes, heading)
    last = max(
        (
            values.max()
            for values in (seen["decisions"], told["decisions"])
            if len(values)
        ),
        default=1.0,
    )
    for axes in figure.axes:
        axes.set_xlim(0, last * 1.02)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def _columns(table: Columns) -> dict[str, NDArray[np.float64]]:
    found = {name: np.asarray(values, np.float64) for name, values in table.items()}
    return {"decisions": np.empty(0), **found}


def _draw_coverage(
    axes: Axes,
    episodes: Mapping[str, NDArray[np.float64]],
    levels: Mapping[str, float],
    window: int,
) -> None:
    _draw_episodes(axes, episodes, "coverage", _BLUE, window)
    for number, (name, level) in enumerate(levels.items()):
        axes.axhline(
            level,
            color=_GREY,
            linestyle=_DASHES[number % len(_DASHES)],
            linewidth=1.4,
            label=f"{name} {level:.0%}",
        )
    axes.set_ylim(0, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    _dress(axes, "Coverage of the training's episodes")
    axes.legend(fontsize=8, frameon=False, loc="lower right")


def _draw_return(
    axes: Axes,
    episodes: Mapping[str, NDArray[np.float64]],
    metrics: Mapping[str, NDArray[np.float64]],
    window: int,
) -> None:
    """The sum that is learned from, its two parts, and new versions of the networks."""
    heading = "Intrinsic return"
    if "coverage" in episodes and "intrinsic_return" in episodes:
        together = correlation(episodes["intrinsic_return"], episodes["coverage"])
        if np.isfinite(together):
            heading += f" (correlation with coverage {together:.2f})"
    _draw_episodes(axes, episodes, "intrinsic_return", _GREEN, window)
    parts = {"count_return": "count part", "temporal_distance_return": "distance part"}
    for (name, label), colour in zip(parts.items(), (_ORANGE, _RED), strict=True):
        if name in episodes:
            axes.plot(
                episodes["decisions"],
                running_mean(episodes[name], window),
                color=colour,
                linewidth=1.3,
                linestyle=_DASHED,
                label=label,
            )
    if axes.lines:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    versions = metrics.get("networks_version", np.empty(0))
    for number, place in enumerate(np.flatnonzero(np.diff(versions) > 0)):
        axes.axvline(
            metrics["decisions"][place + 1],
            color=_GREY,
            linewidth=0.8,
            label=None if number else "new networks",
        )
    _dress(axes, heading)
    _legend(axes, size=8)


def _draw_episodes(
    axes: Axes,
    episodes: Mapping[str, NDArray[np.float64]],
    name: str,
    colour: str,
    window: int,
) -> None:
    """A dot an episode, and the running mean as a line."""
    if name not in episodes or not np.isfinite(episodes[name]).any():
        return
    x, y = episodes["decisions"], episodes[name]
    axes.plot(x, y, ".", color=colour, alpha=0.3, markersize=5, label="episodes")
    axes.plot(
        x,
        running_mean(y, window),
        color=colour,
        linewidth=1.9,
        label=f"mean of the last {window}",
    )


def _draw_small(
    axes: Axes,
    table: Mapping[str, NDArray[np.float64]],
    names: Mapping[str, str],
    window: int,
) -> None:
    """Running means of episodes, or what the learner reported, as it is."""
    for (name, label), colour in zip(names.items(), (_BLUE, _RED), strict=False):
        if name not in table:
            continue
        known = np.isfinite(table[name])
        if not known.any():
            continue
        x, y = table["decisions"][known], table[name][known]
        if "births" in names:
            y = running_mean(y, window)
        axes.plot(
            x,
            y,
            color=colour,
            linewidth=1.4,
            marker="." if len(x) < 20 else None,
            label=f"{label} {y[-1]:.3g}",
        )
    _legend(axes)


def _legend(axes: Axes, size: float = 7.5) -> None:
    if axes.lines:
        axes.legend(fontsize=size, frameon=False, loc="best")
    else:
        axes.text(
            0.5,
            0.5,
            "nothing to show",
            color=_GREY,
            fontsize=9,
            ha="center",
            va="center",
            transform=axes.transAxes,
        )


def _dress(axes: Axes, heading: str) -> None:
    axes.set_title(heading, loc="left", fontsize=10)
    axes.set_xlabel("decisions of the training", fontsize=8.5)
    axes.xaxis.set_major_formatter(FuncFormatter(thousands))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.grid(alpha=0.25)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
