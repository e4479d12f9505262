"""`draw_report`: both networks against ground truth, in one picture of six panels."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator, PercentFormatter
from scipy.special import logit
from torch import Tensor

from toponav.graph import Calibration
from toponav.metrics import DISTANCE_CELLS, HEADINGS, LReport, TCReport
from toponav.plotting.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LEGEND,
    MARKS,
    ORANGE,
    PALE,
    RED,
    add_legend,
    add_text,
    new_figure,
    show_percent,
    style_axes,
)


@dataclass(frozen=True)
class ShareCurve:
    """Waypoint shares ``[S, K]`` of S sequences at K ascending thresholds ``[K]``."""

    thresholds: Tensor
    shares: Tensor


def draw_report(
    tc: TCReport,
    locomotion: LReport,
    waypoints: ShareCurve,
    *,
    marks: Mapping[str, Calibration],
    bound: Tensor,
    num_actions: int,
    pose_bound: float | None = None,
    title: str = "",
) -> Figure:
    """Draw accuracy, similarity, ROC, calibration, waypoint share and L-accuracy.

    Args:
        tc: measures of the TC-network.
        locomotion: measures of the L-network.
        waypoints: shares over thresholds.
        marks: the calibrated thresholds by the name that the legend gives them.
        bound: accuracy of the best guess by offset, from `bayes_bound`, ``[k]``.
        num_actions: of the world, for the accuracy of chance.
        pose_bound: balanced accuracy of a classifier that sees the true poses.
        title: over the picture, for instance maze, decisions and seed.
    """
    figure = new_figure(12, 7.2, title=title)
    panels = dict(zip("abcdef", figure.subplots(2, 3).flat, strict=True))
    _draw_accuracy(panels["a"], tc, pose_bound)
    _draw_similarity(panels["b"], tc)
    _draw_roc(panels["c"], tc)
    _draw_calibration(panels["d"], tc)
    _draw_waypoints(panels["e"], waypoints, marks)
    _draw_locomotion(panels["f"], locomotion, bound, num_actions)
    for letter, axes in panels.items():
        heading = f"{letter}  {axes.get_title()}"
        axes.set_title("")
        style_axes(axes, title=heading, x=axes.get_xlabel(), y=axes.get_ylabel())
    panels["b"].grid(False)
    lines = panels["f"].get_legend_handles_labels()
    place = {"loc": "outside lower right", "ncols": 4, "title": "panel f"}
    figure.legend(*lines, **place, **LEGEND)
    return figure


def _label(axes: Axes, title: str, x: str, y: str, **more: Any) -> None:
    axes.set(title=title, xlabel=x, ylabel=y, **more)


def _draw_accuracy(axes: Axes, tc: TCReport, pose_bound: float | None) -> None:
    lines = (
        (tc.positives_by_distance, BLUE, "o-", "positives called near"),
        (tc.negatives_by_distance, RED, "^-", "negatives called near"),
        (tc.by_distance, INK, "s:", "all pairs, judged right"),
    )
    for binned, colour, style, label in lines:
        middle = np.arange(len(binned.mean)) + 0.5
        axes.plot(middle, binned.mean, style, c=colour, ms=4, label=label)
    numbers = f"n = {tc.num_pairs:,} pairs\nbalanced accuracy {tc.accuracy:.1%}"
    if pose_bound is not None:
        numbers += f"\nfrom true poses {pose_bound:.1%}"
    _label_edges(axes.xaxis, DISTANCE_CELLS)
    heading = "Decision by true distance"
    _label(axes, heading, "walking distance (cells)", "share of pairs")
    show_percent(axes)
    add_legend(axes, title=numbers, loc="center right")


def _draw_similarity(axes: Axes, tc: TCReport) -> None:
    # Empty bins are pale.
    axes.set_facecolor(PALE)
    similarity = tc.similarity.numpy()
    mesh = axes.pcolormesh(similarity, cmap="viridis", vmin=0, vmax=1)
    for (row, column), value in np.ndenumerate(similarity):
        if np.isfinite(value):
            text = f"{value:.2f}".removeprefix("0")
            look = {"fontsize": 6.5, "color": "white" if value < 0.6 else INK}
            add_text(axes, column + 0.5, row + 0.5, text, **look)
    _label_edges(axes.xaxis, DISTANCE_CELLS)
    _label_edges(axes.yaxis, HEADINGS)
    heading = f"Mean similarity (n = {int(tc.similarity_count.sum()):,} pairs)"
    _label(axes, heading, "walking distance (cells)", "heading difference (degrees)")
    axes.figure.colorbar(mesh, ax=axes, pad=0.02).ax.tick_params(labelsize=8)


def _draw_roc(axes: Axes, tc: TCReport) -> None:
    at_half = 1 - tc.negative_accuracy, tc.positive_accuracy
    axes.plot([0, 1], [0, 1], ":", c=GREY, lw=1, label="chance")
    axes.plot(*tc.roc, c=BLUE, label=f"area {tc.auc:.3f}")
    axes.plot(*at_half, "o", c=RED, label="similarity 0.5")
    heading = f"ROC (n = {tc.num_pairs:,} pairs)"
    x, y = "negatives above the threshold", "positives above the threshold"
    _label(axes, heading, x, y, xlim=(-0.02, 1.02))
    axes.xaxis.set_major_formatter(PercentFormatter(1))
    show_percent(axes)
    add_legend(axes, loc="lower right")


def _draw_calibration(axes: Axes, tc: TCReport) -> None:
    said, true = tc.calibration
    share = (said.count / said.count.sum()).numpy()
    bars: dict[str, Any] = {"color": "#c9d8e4", "label": "share of the pairs"}
    axes.bar(said.centres.numpy(), share, width=0.09, **bars)
    axes.plot([0, 1], [0, 1], ":", c=GREY, lw=1, label="perfect")
    # A ring stands for too few pairs: a standard error above 5 points.
    few = true.count < 100
    axes.plot(said.mean, true.mean, "-", c=BLUE, lw=1)
    dots: dict[str, Any] = {"c": BLUE, "ms": 5}
    axes.plot(said.mean[~few], true.mean[~few], "o", label="measured", **dots)
    if bool((few & (true.count > 0)).any()):
        dots |= {"mfc": "white", "label": "under 100 pairs"}
        axes.plot(said.mean[few], true.mean[few], "o", **dots)
    heading = f"Calibration (expected error {tc.calibration_error:.3f})"
    x, y = "similarity (predicted probability)", "positives among the pairs"
    _label(axes, heading, x, y, xlim=(-0.02, 1.02))
    show_percent(axes)
    add_legend(axes, loc="upper left")


def _draw_waypoints(
    axes: Axes, waypoints: ShareCurve, marks: Mapping[str, Calibration]
) -> None:
    """Share over the threshold on logit axes: both ends matter."""
    shares = waypoints.shares.numpy()
    mean = shares.mean(0)
    low, high = np.quantile(shares, [0.1, 0.9], axis=0)
    x = waypoints.thresholds.double().numpy()
    axes.fill_between(x, low, high, color=BLUE, alpha=0.18, lw=0, label="10 to 90 %")
    axes.plot(x, mean, c=BLUE, label="mean")
    colours = (RED, GREEN, ORANGE, INK, GREY)
    for (name, mark), shape, colour in zip(marks.items(), MARKS, colours, strict=False):
        at = mark.threshold
        share = math.exp(np.interp(logit(at), logit(x), np.log(mean)))
        label = f"{name}: {at:.3f} ({share:.1%})"
        axes.plot(at, share, shape, c=colour, ms=7, mec="white", label=label)
    axes.set_xscale("logit")
    axes.set_yscale("log")
    ticks = (0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999)
    inside = [tick for tick in ticks if x[0] <= tick <= x[-1]]
    axes.set_xticks(inside, [f"{tick:g}" for tick in inside])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=None))
    heading = f"Waypoint share (n = {len(shares)} random sequences)"
    _label(axes, heading, "threshold (similarity)", "waypoints per observation")
    add_legend(axes, loc="upper left")


def _draw_locomotion(
    axes: Axes, locomotion: LReport, bound: Tensor, num_actions: int
) -> None:
    """Accuracy in blue, usefulness in green, what could be had in dashes."""
    offset = np.arange(1, len(locomotion.count) + 1)
    chance = torch.full_like(locomotion.accuracy, 1 / num_actions)
    lines = (
        (bound, BLUE, "--", "best possible from true poses"),
        (locomotion.accuracy, BLUE, "o-", "action taken is the most probable"),
        (chance, BLUE, ":", "the same by chance"),
        (locomotion.useful_taken, GREEN, "--", "useful: the action taken"),
        (locomotion.useful_argmax, GREEN, "D-", "useful: the most probable"),
        (locomotion.useful_sampled, GREEN, "^-", "useful: sampled"),
        (locomotion.useful_uniform, GREEN, ":", "useful: a uniform action"),
    )
    for values, colour, style, label in lines:
        axes.plot(offset, values[: len(offset)], style, c=colour, ms=5, label=label)
    heading = f"Locomotion (n = {int(locomotion.count.sum()):,} pairs)"
    _label(axes, heading, "offset (decisions)", "share of pairs")
    axes.set(xticks=offset, xlim=(0.8, len(offset) + 0.2))
    show_percent(axes)


def _label_edges(axis: Axis, edges: tuple[float, ...]) -> None:
    """Bins of unequal width are drawn equally wide; the ticks name their edges."""
    axis.set_ticks(range(len(edges)), [f"{edge:g}" for edge in edges])
