"""Figures over time: of a pre-training, of an exploration, of episodes."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import ArrayLike

from toponav.metrics import Floats, correlation, running_mean, success_within
from toponav.plotting.style import (
    BLUE,
    DASHES,
    GREEN,
    GREY,
    LINE,
    ORANGE,
    PALETTE,
    RED,
    THIN,
    add_legend,
    add_levels,
    new_figure,
    show_percent,
    show_thousands,
    style_axes,
)

#: Names of columns to their values, in the order of the training.
Columns = Mapping[str, ArrayLike]
_Arrays = Mapping[str, Floats]

_X = "decisions of the training"
_WAYPOINTS = {"new_waypoints": "new", "spurious_waypoints": "of them spurious"}
_NETWORK_LOSSES = {"loss_tc": "TC", "loss_locomotion": "L"}


def draw_curves(
    history: Sequence[Mapping[str, float]],
    *,
    panels: Mapping[str, Sequence[str]],
    x: str,
    percent: Sequence[str] = (),
    title: str = "",
) -> Figure:
    """Draw measurements over the course of a run, one panel beside the other.

    Args:
        history: the measurements in order, each by name.
        panels: by the panel's title, the names that it shows if they were measured.
        x: name of the horizontal axis.
        percent: titles of the panels whose values are shares.
        title: over the picture.

    Examples:
        >>> history = [{"update": 1, "loss": 0.7}, {"update": 2, "loss": 0.6}]
        >>> figure = draw_curves(history, panels={"Loss": ["loss"]}, x="update")
    """
    figure = new_figure(4.2 * len(panels), 3.4, title=title)
    row = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (heading, names) in zip(row, panels.items(), strict=True):
        shown = [name for name in names if history and name in history[-1]]
        for number, name in enumerate(shown):
            points = [(entry[x], entry[name]) for entry in history if name in entry]
            axes.plot(
                *zip(*points, strict=True),
                marker=".",
                linewidth=THIN,
                color=PALETTE[number % len(PALETTE)],
                label=f"{name} {points[-1][1]:.3f}",
            )
        if heading in percent:
            axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        style_axes(axes, title=heading, x=x)
        add_legend(axes)
    return figure


def draw_training(
    episodes: Columns,
    metrics: Columns,
    *,
    levels: Mapping[str, float],
    window: int = 16,
    title: str = "",
) -> Figure:
    """Draw every episode's coverage and return, and what the learner reports.

    A panel whose columns a table lacks is absent, such as coverage in a world without
    ground truth.

    Args:
        episodes: columns of ``episodes.csv``, ``[N]``, NaN without a value.
        metrics: columns of ``metrics.csv``, the same.
        levels: coverage in [0, 1] of other policies, by name.
        window: episodes in the running means.
        title: over the picture.

    Examples:
        >>> episodes = {"decisions": [1800, 3600], "coverage": [0.4, 0.5]}
        >>> figure = draw_training(episodes, {}, levels={"uniform random": 0.42})
        >>> [line.get_label() for line in figure.axes[0].lines]
        ['episodes', 'mean of the last 16', 'uniform random 42%']
    """
    per_episode, reported = _to_arrays(episodes), _to_arrays(metrics)
    has_coverage = bool(levels) or _has_values(per_episode, "coverage")
    small = _small_panels(per_episode, reported, window)
    figure = new_figure(12, 6.8, title=title)
    # Twelve columns: the panels of a row share them, however many there are.
    grid = figure.add_gridspec(2, 12, height_ratios=[1.5, 1.0])
    if has_coverage:
        axes = figure.add_subplot(grid[0, :6])
        _draw_episodes(axes, per_episode, "coverage", BLUE, window)
        add_levels(axes, {f"{name} {at:.0%}": at for name, at in levels.items()})
        show_percent(axes)
        style_axes(axes, title="Coverage of the training's episodes", x=_X)
        add_legend(axes, loc="lower right")
    axes = figure.add_subplot(grid[0, 6 if has_coverage else 0 :])
    _draw_return(axes, per_episode, reported, window)
    for number, (heading, lines) in enumerate(small.items()):
        width = 12 // len(small)
        axes = figure.add_subplot(grid[1, number * width : (number + 1) * width])
        for index, (label, (x, y)) in enumerate(lines.items()):
            colour, mark = (
                (BLUE, RED, *PALETTE)[index % 8],
                "." if len(x) < 20 else None,
            )
            axes.plot(x, y, marker=mark, color=colour, lw=THIN, label=label)
        if heading.startswith("Waypoints"):
            axes.set_ylim(bottom=0)
        style_axes(axes, title=heading, x=_X)
        add_legend(axes)
    ends = [table["decisions"].max(initial=0) for table in (per_episode, reported)]
    for axes in figure.axes:
        axes.set_xlim(0, (max(ends) or 1.0) * 1.02)
        show_thousands(axes)
    return figure


def _to_arrays(table: Columns) -> dict[str, Floats]:
    found = {name: np.asarray(values, np.float64) for name, values in table.items()}
    return {"decisions": np.empty(0), **found}


def _has_values(table: _Arrays, name: str) -> bool:
    return name in table and bool(np.isfinite(table[name]).any())


def _draw_episodes(
    axes: Axes, episodes: _Arrays, name: str, colour: str, window: int
) -> None:
    if not _has_values(episodes, name):
        return
    x, y = episodes["decisions"], episodes[name]
    axes.plot(x, y, ".", color=colour, alpha=0.3, markersize=4, label="episodes")
    label = f"mean of the last {window}"
    axes.plot(x, running_mean(y, window), color=colour, linewidth=LINE, label=label)


def _draw_return(axes: Axes, episodes: _Arrays, metrics: _Arrays, window: int) -> None:
    heading = "Intrinsic return"
    if {"coverage", "intrinsic_return"} <= set(episodes):
        together = correlation(episodes["intrinsic_return"], episodes["coverage"])
        if np.isfinite(together):
            heading += f" (correlation with coverage {together:.2f})"
    _draw_episodes(axes, episodes, "intrinsic_return", GREEN, window)
    parts = [name for name in episodes if name.endswith("_return")]
    parts = [name for name in parts if name != "intrinsic_return"]
    for number, name in enumerate(parts):
        y = running_mean(episodes[name], window)
        label = name.removesuffix("_return").replace("_", " ") + " part"
        look: dict[str, Any] = {
            "color": (ORANGE, RED, *PALETTE)[number % 8],
            "linestyle": "--",
        }
        axes.plot(episodes["decisions"], y, linewidth=THIN, label=label, **look)
    if axes.lines:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    versions = metrics.get("networks_version", np.empty(0))
    for number, row in enumerate(np.flatnonzero(np.diff(versions) > 0)):
        place = metrics["decisions"][row + 1]
        once = None if number else "new networks"
        axes.axvline(place, color=GREY, linewidth=0.8, label=once)
    style_axes(axes, title=heading, x=_X)
    add_legend(axes)


def _small_panels(
    episodes: _Arrays, metrics: _Arrays, window: int
) -> dict[str, dict[str, tuple[Floats, Floats]]]:
    """By heading, the lines of each panel; without a panel that no column is for."""
    # The entropy bonus is a multiple of the entropy, which has a panel.
    losses = [name for name in metrics if name.startswith("loss_")]
    policy = {
        name: name.removeprefix("loss_")
        for name in losses
        if name not in _NETWORK_LOSSES and name != "loss_entropy"
    }
    panels = {
        "Waypoints per episode": (episodes, _WAYPOINTS),
        "Entropy of the policy": (metrics, {"entropy": "entropy"}),
        "Losses of the policy": (metrics, policy),
        "Losses of the networks": (metrics, _NETWORK_LOSSES),
    }
    found: dict[str, dict[str, tuple[Floats, Floats]]] = {}
    for heading, (table, names) in panels.items():
        has_just_begun = not len(table["decisions"])
        if not has_just_begun and not set(names) & set(table):
            continue
        lines = found.setdefault(heading, {})
        for name, label in names.items():
            if _has_values(table, name):
                known = np.isfinite(table[name])
                x, y = table["decisions"][known], table[name][known]
                y = running_mean(y, window) if table is episodes else y
                lines[f"{label} {y[-1]:.3g}"] = x, y
    return found


def draw_success(
    first: Mapping[str, ArrayLike], *, decisions: int, title: str = ""
) -> Figure:
    """Draw the share of the episodes that reached their goal within so many decisions.

    Reference:
        The paper, Figs. 20 and 22.

    Args:
        first: by policy, decisions to the first goal, ``[N]``, -1 without one.
        decisions: of an episode: the right end.
        title: over the picture.

    Examples:
        >>> figure = draw_success({"ours": [40, 90, -1, 60]}, decisions=100)
        >>> figure.axes[0].lines[0].get_label()
        'ours 75%'
    """
    figure = new_figure(5.6, 3.8, title=title)
    axes = figure.subplots()
    times = np.arange(decisions + 1)
    for number, (name, taken) in enumerate(first.items()):
        share = success_within(taken, times)
        colour, dashes = PALETTE[number % len(PALETTE)], DASHES[number % len(DASHES)]
        label = f"{name} {share[-1]:.0%}"
        look: dict[str, Any] = {"color": colour, "linestyle": dashes, "label": label}
        axes.step(times, share, where="post", linewidth=LINE, **look)
    show_percent(axes)
    axes.set_xlim(0, decisions)
    x, y = (
        "decisions since the start of the episode",
        "episodes that reached their goal",
    )
    style_axes(axes, x=x, y=y)
    add_legend(axes, loc="lower right")
    return figure
