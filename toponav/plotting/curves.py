"""Figures over time: of a pre-training, of an exploration, of episodes."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import ArrayLike

from toponav.metrics import correlation, running_mean, success_within
from toponav.plotting import style

#: Columns by name, or rows with a number by name each; NaN where there is none.
Table = Mapping[str, ArrayLike] | Sequence[Mapping[str, float]]

_X = "decisions of the training"
_EPISODES_WAYPOINTS = "Waypoints per episode"
# Why a panel is empty: of many environments whole episodes take many decisions.
_NO_EPISODE, _NO_ROW = "no whole episode has ended yet", "nothing measured so far"
_WAYPOINTS = {"new_waypoints": "new", "spurious_waypoints": "of them spurious"}
_NETWORK_LOSSES = {"loss_tc": "TC", "loss_locomotion": "L"}


def draw_curves(
    history: Sequence[Mapping[str, float]],
    *,
    panels: Mapping[str, Sequence[str]],
    x: str,
    percent: Sequence[str] = (),
) -> Figure:
    """Draw measurements over the course of a run, one panel beside the other.

    ``panels`` has, by title, the names that each shows if they were measured, over the
    name ``x``; ``percent`` the titles of those whose values are shares.

    Examples:
        >>> history = [{"update": 1, "loss": 0.7}, {"update": 2, "loss": 0.6}]
        >>> figure = draw_curves(history, panels={"Loss": ["loss"]}, x="update")
    """
    figure = style.new_figure(4.2 * len(panels), 3.4)
    row = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (heading, names) in zip(row, panels.items(), strict=True):
        shown = [name for name in names if history and name in history[-1]]
        for name, colour in zip(shown, cycle(style.PALETTE), strict=False):
            points = [(entry[x], entry[name]) for entry in history if name in entry]
            places, values = zip(*points, strict=True)
            label = f"{name} {values[-1]:.3f}"
            axes.plot(places, values, ".-", lw=style.THIN, c=colour, label=label)
        if heading in percent:
            axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        style.finish(axes, title=heading, x=x)
    return figure


def draw_training(
    episodes: Table,
    metrics: Table,
    *,
    levels: Mapping[str, float],
    window: int = 16,
    title: str = "",
) -> Figure:
    """Draw every episode's coverage and return, and what the learner reports.

    A panel whose columns the tables ``episodes.csv`` and ``metrics.csv`` lack is
    absent, such as coverage in a world without ground truth. ``levels`` are coverages
    in [0, 1] of other policies; ``window`` episodes are in the running means.

    Examples:
        >>> episodes = {"decisions": [1800, 3600], "coverage": [0.4, 0.5]}
        >>> figure = draw_training(episodes, {}, levels={"uniform random": 0.42})
        >>> [line.get_label() for line in figure.axes[0].lines]
        ['episodes', 'mean of the last 16 (fewer at first)', 'uniform random 42%']
    """
    per_episode, reported = _to_frame(episodes), _to_frame(metrics)
    has_running = _has_values(reported, "running_coverage")
    has_coverage = levels or has_running or _has_values(per_episode, "coverage")
    figure = style.new_figure(12, 6.8, title=title)
    # Twelve columns: the panels of a row share them, however many there are.
    grid = figure.add_gridspec(2, 12, height_ratios=[1.5, 1.0])
    if has_coverage:
        axes = figure.add_subplot(grid[0, :6])
        _draw_episodes(axes, per_episode, "coverage", style.BLUE, window)
        _draw_running(axes, reported, "running_coverage")
        style.add_levels(axes, {f"{name} {at:.0%}": at for name, at in levels.items()})
        style.show_percent(axes)
        heading = "Coverage of the training's episodes"
        style.finish(axes, title=heading, x=_X, legend="lower right")
    axes = figure.add_subplot(grid[0, 6 if has_coverage else 0 :])
    _draw_return(axes, per_episode, reported, window)
    small = _small_panels(per_episode, reported)
    for number, (heading, (table, names)) in enumerate(small.items()):
        width = 12 // len(small)
        axes = figure.add_subplot(grid[1, number * width : (number + 1) * width])
        _draw_columns(axes, table, names, window if table is per_episode else None)
        if heading == _EPISODES_WAYPOINTS:
            _draw_running(axes, reported, "running_waypoints")
            axes.set_ylim(bottom=0)
        empty = _NO_EPISODE if heading == _EPISODES_WAYPOINTS else _NO_ROW
        style.finish(axes, title=heading, x=_X, empty=empty)
    ends = pd.concat([per_episode["decisions"], reported["decisions"]])
    for axes in figure.axes:
        axes.set_xlim(0, (ends.max() if len(ends) else 1.0) * 1.02)
        style.show_thousands(axes)
    return figure


def _to_frame(table: Table) -> pd.DataFrame:
    frame = pd.DataFrame(table).astype(float)
    return frame if len(frame) else pd.DataFrame({"decisions": np.empty(0)})


def _has_values(table: pd.DataFrame, name: str) -> bool:
    return name in table and bool(table[name].notna().any())


def _draw_episodes(
    axes: Axes, episodes: pd.DataFrame, name: str, colour: str, window: int
) -> None:
    if not _has_values(episodes, name):
        return
    x, y = episodes["decisions"], episodes[name]
    axes.plot(x, y, ".", color=colour, alpha=0.3, markersize=4, label="episodes")
    label = f"mean of the last {window} (fewer at first)"
    axes.plot(x, running_mean(y, window), c=colour, lw=style.LINE, label=label)


def _draw_running(axes: Axes, metrics: pd.DataFrame, name: str) -> None:
    if _has_values(metrics, name):
        x, label = metrics["decisions"], "running episodes so far"
        axes.plot(x, metrics[name], c=style.SKY, lw=style.THIN, label=label)


def _draw_return(
    axes: Axes, episodes: pd.DataFrame, metrics: pd.DataFrame, window: int
) -> None:
    """Draw the return, its parts, and where the networks were replaced."""
    heading = "Return of the training's episodes"
    if {"coverage", "intrinsic_return"} <= set(episodes):
        together = correlation(episodes["intrinsic_return"], episodes["coverage"])
        if np.isfinite(together):
            heading += f" (correlation with coverage {together:.2f})"
    _draw_episodes(axes, episodes, "intrinsic_return", style.GREEN, window)
    parts = [name for name in episodes if name.endswith("_return")]
    parts = [name for name in parts if name != "intrinsic_return"]
    colours = cycle((style.ORANGE, style.RED, *style.PALETTE))
    for name, colour in zip(parts, colours, strict=False):
        x, y = episodes["decisions"], running_mean(episodes[name], window)
        label = name.removesuffix("_return").replace("_", " ") + " part"
        axes.plot(x, y, "--", c=colour, lw=style.THIN, label=label)
    if axes.lines:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    if "networks_version" in metrics:
        is_new = metrics["networks_version"].diff() > 0
        for number, place in enumerate(metrics["decisions"][is_new]):
            once = None if number else "new networks"
            axes.axvline(place, color=style.GREY, linewidth=0.8, label=once)
    style.finish(axes, title=heading, x=_X, empty=_NO_EPISODE)


def _small_panels(
    episodes: pd.DataFrame, metrics: pd.DataFrame
) -> dict[str, tuple[pd.DataFrame, dict[str, str]]]:
    """By heading, a table and the labels of its columns; only where it has some."""
    # The entropy bonus is a multiple of the entropy, which has a panel.
    other = (*_NETWORK_LOSSES, "loss_entropy")
    losses = [name for name in metrics.filter(regex="^loss_") if name not in other]
    policy = {name: name.removeprefix("loss_") for name in losses}
    panels = {
        _EPISODES_WAYPOINTS: (episodes, _WAYPOINTS),
        "Entropy of the policy": (metrics, {"entropy": "entropy"}),
        "Losses of the policy": (metrics, policy),
        "Losses of the networks": (metrics, _NETWORK_LOSSES),
    }
    return {
        heading: (table, names)
        for heading, (table, names) in panels.items()
        # What has just begun shows what it will have.
        if table.empty or not table.columns.intersection(list(names)).empty
    }


def _draw_columns(
    axes: Axes, table: pd.DataFrame, labels: Mapping[str, str], window: int | None
) -> None:
    """Draw columns without their gaps, as running means if there is a window."""
    names = [name for name in labels if _has_values(table, name)]
    colours = cycle((style.BLUE, style.RED, *style.PALETTE))
    for name, colour in zip(names, colours, strict=False):
        known = table[["decisions", name]].dropna()
        x, y = known["decisions"], known[name].to_numpy()
        y = y if window is None else running_mean(y, window)
        mark, label = "." if len(x) < 20 else None, f"{labels[name]} {y[-1]:.3g}"
        axes.plot(x, y, marker=mark, color=colour, lw=style.THIN, label=label)


def draw_success(
    first: Mapping[str, ArrayLike], *, decisions: int, title: str = ""
) -> Figure:
    """Draw the share of the episodes that reached their goal by a number of decisions.

    ``first`` has, by policy, the decisions to the first goal, ``[N]``, -1 without one.

    Reference:
        The paper, Figs. 20 and 22.

    Examples:
        >>> figure = draw_success({"ours": [40, 90, -1, 60]}, decisions=100)
        >>> figure.axes[0].lines[0].get_label()
        'ours 75%'
    """
    figure = style.new_figure(5.6, 3.8, title=title)
    axes = figure.subplots()
    times = np.arange(decisions + 1)
    looks = zip(cycle(style.PALETTE), cycle(style.DASHES), strict=False)
    for (name, taken), (colour, dashes) in zip(first.items(), looks, strict=False):
        share = success_within(taken, times)
        look: dict[str, Any] = {"c": colour, "ls": dashes, "lw": style.LINE}
        axes.step(times, share, where="post", label=f"{name} {share[-1]:.0%}", **look)
    style.show_percent(axes)
    axes.set_xlim(0, decisions)
    x, legend = "decisions since the start of the episode", "lower right"
    style.finish(axes, x=x, y="episodes that reached their goal", legend=legend)
    return figure
