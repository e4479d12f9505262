"""`draw_report`: both networks against ground truth, in one picture of six panels."""

import math
from collections.abc import Mapping

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
from toponav.plotting import style


def draw_report(
    tc: TCReport,
    locomotion: LReport,
    waypoints: tuple[Tensor, Tensor],
    *,
    marks: Mapping[str, Calibration],
    bound: Tensor,
    num_actions: int,
    pose_bound: float,
    title: str,
) -> Figure:
    """Draw accuracy, similarity, ROC, calibration, waypoint share and L-accuracy.

    ``waypoints`` are K ascending thresholds and the shares ``[S, K]`` of S sequences at
    them, ``marks`` the calibrated thresholds by the name that the legend gives them.
    The networks are compared with the best guess by offset, `bayes_bound` ``[k]``, with
    chance, and with a classifier that sees the true poses (`pose_bound`).
    """
    figure = style.new_figure(12, 7.2, title=title)
    a, b, c, d, e, f = figure.subplots(2, 3).flat
    _draw_accuracy(a, tc, pose_bound)
    _draw_similarity(b, tc)
    _draw_roc(c, tc)
    _draw_calibration(d, tc)
    _draw_waypoints(e, waypoints, marks)
    _draw_locomotion(f, locomotion, bound, num_actions)
    place = {"loc": "outside lower right", "ncols": 4, "title": "panel f"}
    figure.legend(*f.get_legend_handles_labels(), **place, **style.LEGEND)
    return figure


def _draw_accuracy(axes: Axes, tc: TCReport, pose_bound: float) -> None:
    lines = (
        (tc.positives_by_distance, style.BLUE, "o-", "positives called near"),
        (tc.negatives_by_distance, style.RED, "^-", "negatives called near"),
        (tc.by_distance, style.INK, "s:", "all pairs, judged right"),
    )
    for binned, colour, mark, label in lines:
        middle = np.arange(len(binned.mean)) + 0.5
        axes.plot(middle, binned.mean, mark, c=colour, ms=4, label=label)
    numbers = f"n = {tc.num_pairs:,} pairs\nbalanced accuracy {tc.accuracy:.1%}"
    numbers += f"\nfrom true poses {pose_bound:.1%}"
    _label_edges(axes.xaxis, DISTANCE_CELLS)
    style.show_percent(axes)
    x, legend = "walking distance (cells)", "center right"
    title = "a  Decision by true distance"
    y = "share of pairs"
    style.finish(axes, title=title, x=x, y=y, legend=legend, note=numbers)


def _draw_similarity(axes: Axes, tc: TCReport) -> None:
    # Empty bins are pale.
    axes.set_facecolor(style.PALE)
    similarity = tc.similarity.numpy()
    mesh = axes.pcolormesh(similarity, cmap="viridis", vmin=0, vmax=1)
    for (row, column), value in np.ndenumerate(similarity):
        if np.isfinite(value):
            text = f"{value:.2f}".removeprefix("0")
            colour = "white" if value < 0.6 else style.INK
            middle = (column + 0.5, row + 0.5)
            axes.text(*middle, text, style.CENTRED, size=6.5, color=colour)
    _label_edges(axes.xaxis, DISTANCE_CELLS)
    _label_edges(axes.yaxis, HEADINGS)
    axes.figure.colorbar(mesh, ax=axes, pad=0.02).ax.tick_params(labelsize=8)
    title = f"b  Mean similarity (n = {int(tc.similarity_count.sum()):,} pairs)"
    x, y = "walking distance (cells)", "heading difference (degrees)"
    style.finish(axes, title=title, x=x, y=y, legend=None)
    axes.grid(False)


def _draw_roc(axes: Axes, tc: TCReport) -> None:
    at_half = 1 - tc.negative_accuracy, tc.positive_accuracy
    axes.plot([0, 1], [0, 1], ":", c=style.GREY, lw=1, label="chance")
    axes.plot(*tc.roc, c=style.BLUE, label=f"area {tc.auc:.3f}")
    axes.plot(*at_half, "o", c=style.RED, label="similarity 0.5")
    axes.set_xlim(-0.02, 1.02)
    axes.xaxis.set_major_formatter(PercentFormatter(1))
    style.show_percent(axes)
    title = f"c  ROC (n = {tc.num_pairs:,} pairs)"
    x, y = "negatives above the threshold", "positives above the threshold"
    style.finish(axes, title=title, x=x, y=y, legend="lower right")


def _draw_calibration(axes: Axes, tc: TCReport) -> None:
    said, true = tc.calibration
    share = (said.count / said.count.sum()).numpy()
    label = "share of the pairs"
    axes.bar(said.centres.numpy(), share, width=0.09, color="#c9d8e4", label=label)
    axes.plot([0, 1], [0, 1], ":", c=style.GREY, lw=1, label="perfect")
    # A ring stands for too few pairs: a standard error above 5 points.
    few = true.count < 100
    axes.plot(said.mean, true.mean, "-", c=style.BLUE, lw=1)
    some, others = (said.mean[~few], true.mean[~few]), (said.mean[few], true.mean[few])
    axes.plot(*some, "o", c=style.BLUE, ms=5, label="measured")
    if bool((few & (true.count > 0)).any()):
        label = "under 100 pairs"
        axes.plot(*others, "o", c=style.BLUE, ms=5, mfc="white", label=label)
    axes.set_xlim(-0.02, 1.02)
    style.show_percent(axes)
    title = f"d  Calibration (expected error {tc.calibration_error:.3f})"
    x, y = "similarity (predicted probability)", "positives among the pairs"
    style.finish(axes, title=title, x=x, y=y, legend="upper left")


def _draw_waypoints(
    axes: Axes, waypoints: tuple[Tensor, Tensor], marks: Mapping[str, Calibration]
) -> None:
    """Share over the threshold on logit axes: both ends matter."""
    at, shares = (values.double().numpy() for values in waypoints)
    mean = shares.mean(0)
    low, high = np.quantile(shares, [0.1, 0.9], axis=0)
    label, colour = "10 to 90 %", style.BLUE
    axes.fill_between(at, low, high, color=colour, alpha=0.18, lw=0, label=label)
    axes.plot(at, mean, c=style.BLUE, label="mean")
    colours = (style.RED, style.GREEN, style.ORANGE, style.INK, style.GREY)
    looks = zip(marks.items(), style.MARKS, colours, strict=False)
    for (name, mark), shape, colour in looks:
        here = mark.threshold
        share, about = mark.achieved, ""
        if not mark.per_sequence:
            # What it achieves is no share of waypoints, which the curve has.
            share = math.exp(np.interp(logit(here), logit(at), np.log(mean)))
            about = "about "
        label = f"{name}: {here:.3f} ({about}{share:.1%})"
        axes.plot(here, share, shape, c=colour, ms=7, mec="white", label=label)
    axes.set_xscale("logit")
    axes.set_yscale("log")
    ticks = (0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999)
    inside = [tick for tick in ticks if at[0] <= tick <= at[-1]]
    axes.set_xticks(inside, [f"{tick:g}" for tick in inside])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=None))
    title = f"e  Waypoint share (n = {len(shares)} random sequences)"
    x, y = "threshold (similarity)", "waypoints per observation"
    style.finish(axes, title=title, x=x, y=y, legend="upper left")


def _draw_locomotion(
    axes: Axes, locomotion: LReport, bound: Tensor, num_actions: int
) -> None:
    """Accuracy in blue, usefulness in green, what could be had in dashes."""
    offset = np.arange(1, len(locomotion.count) + 1)
    chance = torch.full_like(locomotion.accuracy, 1 / num_actions)
    lines = (
        (bound, style.BLUE, "--", "best possible from true poses"),
        (locomotion.accuracy, style.BLUE, "o-", "action taken is the most probable"),
        (chance, style.BLUE, ":", "the same by chance"),
        (locomotion.useful_taken, style.GREEN, "--", "useful: the action taken"),
        (locomotion.useful_argmax, style.GREEN, "D-", "useful: the most probable"),
        (locomotion.useful_sampled, style.GREEN, "^-", "useful: sampled"),
        (locomotion.useful_uniform, style.GREEN, ":", "useful: a uniform action"),
    )
    for values, colour, mark, label in lines:
        axes.plot(offset, values[: len(offset)], mark, c=colour, ms=5, label=label)
    axes.set(xticks=offset, xlim=(0.8, len(offset) + 0.2))
    style.show_percent(axes)
    title = f"f  Locomotion (n = {int(locomotion.count.sum()):,} pairs)"
    x, y = "offset (decisions)", "share of pairs"
    style.finish(axes, title=title, x=x, y=y, legend=None)


def _label_edges(axis: Axis, edges: tuple[float, ...]) -> None:
    """Bins of unequal width are drawn equally wide; the ticks name their edges."""
    axis.set_ticks(range(len(edges)), [f"{edge:g}" for edge in edges])
