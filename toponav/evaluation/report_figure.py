"""`draw_report`: the networks against the truth, in one picture of six panels."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator, PercentFormatter
from torch import Tensor

from toponav.evaluation.calibration import Calibration
from toponav.evaluation.l_report import LReport
from toponav.evaluation.tc_report import DISTANCE_CELLS, HEADINGS, TCReport

# Okabe and Ito's colours, which colour-blind readers can tell apart.
_BLUE, _ORANGE, _GREEN, _RED = "#0072b2", "#e69f00", "#009e73", "#d55e00"
_INK, _GREY = "#22252a", "#767b83"
_MARKS = "oD^sv"
_LEGEND: dict[str, Any] = {"fontsize": 7.5, "frameon": False, "title_fontsize": 7.5}


@dataclass(frozen=True)
class ShareCurve:
    """Waypoint shares of S sequences, from `share_curve`, at K thresholds.

    Args:
        thresholds: ``[K]``, ascending, within (0, 1).
        shares: ``[S, K]``.
    """

    thresholds: Tensor
    shares: Tensor


def draw_report(
    tc: TCReport,
    locomotion: LReport,
    waypoints: ShareCurve,
    *,
    marks: Mapping[str, Calibration],
    bound: Tensor,
    pose_bound: float | None = None,
    title: str = "",
) -> Figure:
    """Draw accuracy, similarity, ROC, calibration, waypoint share and L-accuracy.

    Args:
        tc: the temporal correlation's measures.
        locomotion: the locomotion network's.
        waypoints: shares over thresholds.
        marks: the calibrated thresholds by the name that the legend gives them.
        bound: accuracy of the best guess by offset, from `bayes_bound`, ``[k]``.
        pose_bound: balanced accuracy of a classifier that sees the true poses.
        title: over the picture, for instance maze, decisions and seed.

    Returns:
        A figure of 12 x 7.2 inches, with no window; ``savefig`` writes it.
    """
    figure = Figure(figsize=(12, 7.2), layout="constrained")
    panels = figure.subplots(2, 3)
    _draw_accuracy(panels[0, 0], tc, pose_bound)
    _draw_similarity(figure, panels[0, 1], tc)
    _draw_roc(panels[0, 2], tc)
    _draw_calibration(panels[1, 0], tc)
    _draw_waypoints(panels[1, 1], waypoints, marks)
    _draw_locomotion(figure, panels[1, 2], locomotion, bound)
    for letter, axes in zip("abcdef", panels.flat, strict=True):
        axes.set_title(f"{letter}  {axes.get_title()}", loc="left", fontsize=10)
        axes.set_title("")
        axes.tick_params(labelsize=8, color=_GREY)
        axes.spines[["top", "right"]].set_visible(False)
    if title:
        figure.suptitle(title, fontsize=11, color=_INK)
    return figure


def _draw_accuracy(axes: Axes, tc: TCReport, pose_bound: float | None) -> None:
    """Share called near over distance, of positives and of negatives."""
    lines = (
        (tc.positives_by_distance, _BLUE, "o-", "positives called near"),
        (tc.negatives_by_distance, _RED, "^-", "negatives called near"),
        (tc.by_distance, _INK, "s:", "all pairs, judged right"),
    )
    for binned, colour, style, label in lines:
        middle = np.arange(len(binned.mean)) + 0.5
        axes.plot(middle, binned.mean, style, c=colour, ms=4, label=label)
    note = f"n = {tc.num_pairs:,} pairs\nbalanced accuracy {tc.accuracy:.1%}"
    if pose_bound is not None:
        note += f"\nfrom true poses {pose_bound:.1%}"
    _label_edges(axes.xaxis, DISTANCE_CELLS)
    axes.set(
        title="Decision by true distance",
        xlabel="walking distance (cells)",
        ylabel="share of pairs",
    )
    _set_percent(axes)
    axes.legend(title=note, loc="center right", **_LEGEND)


def _draw_similarity(figure: Figure, axes: Axes, tc: TCReport) -> None:
    """Mean similarity over distance and heading difference; empty bins are grey."""
    axes.set_facecolor("#d9dadc")
    mesh = axes.pcolormesh(tc.similarity.numpy(), cmap="viridis", vmin=0, vmax=1)
    for (row, column), value in np.ndenumerate(tc.similarity.numpy()):
        if np.isfinite(value):
            axes.text(
                column + 0.5,
                row + 0.5,
                f"{value:.2f}".removeprefix("0"),
                ha="center",
                va="center",
                fontsize=6.5,
                color="white" if value < 0.6 else _INK,
            )
    _label_edges(axes.xaxis, DISTANCE_CELLS)
    _label_edges(axes.yaxis, HEADINGS)
    axes.set(
        title=f"Mean similarity (n = {int(tc.similarity_count.sum()):,} pairs)",
        xlabel="walking distance (cells)",
        ylabel="heading difference (degrees)",
    )
    bar = figure.colorbar(mesh, ax=axes, pad=0.02)
    bar.ax.tick_params(labelsize=8)


def _draw_roc(axes: Axes, tc: TCReport) -> None:
    false_rate, true_rate = tc.roc
    axes.plot([0, 1], [0, 1], ":", c=_GREY, lw=1, label="chance")
    axes.plot(false_rate, true_rate, c=_BLUE, label=f"area {tc.auc:.3f}")
    axes.plot(
        1 - tc.negative_accuracy,
        tc.positive_accuracy,
        "o",
        c=_RED,
        label="similarity 0.5",
    )
    axes.set(
        title=f"ROC (n = {tc.num_pairs:,} pairs)",
        xlabel="negatives above the threshold",
        ylabel="positives above the threshold",
        xlim=(-0.02, 1.02),
    )
    axes.xaxis.set_major_formatter(PercentFormatter(1))
    _set_percent(axes)
    axes.legend(loc="lower right", **_LEGEND)


def _draw_calibration(axes: Axes, tc: TCReport) -> None:
    """Share of positives over predicted probability, and the bins' shares below."""
    said, true = tc.calibration
    share = said.count / said.count.sum()
    axes.bar(
        said.centres.numpy(),
        share.numpy(),
        width=0.09,
        color="#c9d8e4",
        label="share of the pairs",
    )
    axes.plot([0, 1], [0, 1], ":", c=_GREY, lw=1, label="perfect")
    # A ring stands for too few pairs: a standard error above 5 points.
    few = true.count < 100
    axes.plot(said.mean, true.mean, "-", c=_BLUE, lw=1)
    axes.plot(said.mean[~few], true.mean[~few], "o", c=_BLUE, ms=5, label="measured")
    if bool((few & (true.count > 0)).any()):
        axes.plot(
            said.mean[few],
            true.mean[few],
            "o",
            mfc="white",
            c=_BLUE,
            ms=5,
            label="under 100 pairs",
        )
    axes.set(
        title=f"Calibration (expected error {tc.calibration_error:.3f})",
        xlabel="similarity (predicted probability)",
        ylabel="positives among the pairs",
        xlim=(-0.02, 1.02),
    )
    _set_percent(axes)
    axes.legend(loc="upper left", **_LEGEND)


def _draw_waypoints(
    axes: Axes, waypoints: ShareCurve, marks: Mapping[str, Calibration]
) -> None:
    """Share over the threshold on logit axes: both ends matter."""
    shares = waypoints.shares.numpy()
    mean = shares.mean(0)
    low, high = np.quantile(shares, [0.1, 0.9], axis=0)
    thresholds = waypoints.thresholds.double().numpy()
    logit = np.log(thresholds / (1 - thresholds))
    axes.fill_between(
        thresholds, low, high, color=_BLUE, alpha=0.18, lw=0, label="10 to 90 %"
    )
    axes.plot(thresholds, mean, c=_BLUE, label="mean")
    colours = (_RED, _GREEN, _ORANGE, _INK, _GREY)
    for (name, mark), shape, colour in zip(
        marks.items(), _MARKS, colours, strict=False
    ):
        at = math.log(mark.threshold / (1 - mark.threshold))
        share = math.exp(np.interp(at, logit, np.log(mean)))
        label = f"{name}: {mark.threshold:.3f} ({share:.1%})"
        axes.plot(
            mark.threshold, share, shape, c=colour, ms=7, mec="white", label=label
        )
    axes.set_xscale("logit")
    axes.set_yscale("log")
    ticks = (0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999)
    inside = [tick for tick in ticks if thresholds[0] <= tick <= thresholds[-1]]
    axes.set_xticks(inside, [f"{tick:g}" for tick in inside])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=None))
    axes.set(
        title=f"Waypoint share (n = {len(shares)} random sequences)",
        xlabel="threshold (similarity)",
        ylabel="waypoints per observation",
    )
    axes.grid(alpha=0.25, lw=0.5)
    axes.legend(loc="upper left", **_LEGEND)


def _draw_locomotion(
    figure: Figure, axes: Axes, locomotion: LReport, bound: Tensor
) -> None:
    """Accuracy in blue, usefulness in green, what could be had in dashes."""
    offset = np.arange(1, len(locomotion.count) + 1)
    lines = (
        (bound, _BLUE, "--", "action told from true poses, at best"),
        (locomotion.accuracy, _BLUE, "o-", "action taken is the most probable"),
        (locomotion.accuracy * 0 + 1 / 6, _BLUE, ":", "the same by chance"),
        (locomotion.useful_taken, _GREEN, "--", "useful: the action taken"),
        (locomotion.useful_argmax, _GREEN, "D-", "useful: the most probable"),
        (locomotion.useful_sampled, _GREEN, "^-", "useful: sampled"),
        (locomotion.useful_uniform, _GREEN, ":", "useful: a uniform action"),
    )
    for values, colour, style, label in lines:
        axes.plot(offset, values[: len(offset)], style, c=colour, ms=5, label=label)
    axes.set(
        title=f"Locomotion (n = {int(locomotion.count.sum()):,} pairs)",
        xlabel="offset (decisions)",
        ylabel="share of pairs",
        xticks=offset,
        xlim=(0.8, len(offset) + 0.2),
    )
    _set_percent(axes)
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="outside lower right",
        ncols=4,
        title="panel f",
        alignment="left",
        **_LEGEND,
    )


def _label_edges(axis: Axis, edges: tuple[float, ...]) -> None:
    """Bins of unequal width are drawn equally wide; the ticks name their edges."""
    axis.set_ticks(range(len(edges)), [f"{edge:g}" for edge in edges])


def _set_percent(axes: Axes) -> None:
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1))
    axes.grid(alpha=0.25, lw=0.5)
