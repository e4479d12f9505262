"""`draw_goals`: how many goals each policy reached, a bar each."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from toponav.plotting import style


def draw_goals(
    goals: Mapping[str, tuple[float, float, float]],
    *,
    best: str | None = None,
    title: str = "",
) -> Figure:
    """Draw the goals of each policy, the first one at the top, with their intervals.

    Args:
        goals: of each policy the mean of its episodes, and both ends of its interval.
        best: the policy of which all others are a share, if it is there.
        title: of the figure.

    Examples:
        >>> goals = {"navigator": (30.0, 25.0, 36.0), "oracle": (120.0, 118.0, 121.0)}
        >>> figure = draw_goals(goals, best="oracle")
        >>> [text.get_text() for text in figure.axes[0].texts]
        ['30 (25%)', '120 (100%)']
    """
    figure = style.new_figure(6.4, 1.0 + 0.32 * len(goals), title=title)
    axes, rows = figure.subplots(), np.arange(len(goals))
    mean, low, high = np.array(list(goals.values()), float).T
    colours = [style.GREY if name == best else style.BLUE for name in goals]
    axes.barh(rows, mean, color=colours, height=0.62, alpha=0.85)
    ends = np.stack([mean - low, high - mean])
    axes.errorbar(mean, rows, xerr=ends, fmt="none", ecolor=style.INK, capsize=2.5)
    whole = goals[best][0] if best is not None and best in goals else 0.0
    for row, value, end in zip(rows, mean, high, strict=True):
        label = f"{value:.3g} ({value / whole:.0%})" if whole else f"{value:.3g}"
        at = (max(value, end), row)
        move: dict[str, Any] = {"xytext": (6, 0), "textcoords": "offset points"}
        axes.annotate(label, at, va="center", fontsize=style.TEXT, **move)
    axes.set_yticks(rows, list(goals))
    axes.invert_yaxis()
    axes.margins(x=0.18)
    axes.set_xlim(left=0)
    share = f" (share of the {best})" if whole else ""
    style.finish(axes, x=f"goals in an episode{share}", legend=None)
    return figure
