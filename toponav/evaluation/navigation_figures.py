"""Pictures of navigation, drawn with matplotlib.

- `draw_success`: how many episodes reached their goal in how many decisions.
- `draw_leg`: a way to the goal on the plan, with the map it was planned on.
"""

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import ArrayLike

from toponav.evaluation.navigation_metrics import success_within
from toponav.evaluation.plan import AGENT, INK, START, draw_agent

# Okabe and Ito's colours, which colour-blind readers can tell apart, and dashes for
# those who see none.
_COLOURS = ("#0072b2", "#e69f00", "#6b6b6b", "#009e73", "#cc79a7", "#d55e00")
_DASHES = ("-", "--", ":", "-.")
_EDGE, _PLANNED, _CUT = "#8c9bab", "#009e73", "#c1121f"


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

    Returns:
        A figure with no window; ``savefig`` writes it.

    Examples:
        >>> figure = draw_success({"ours": [40, 90, -1, 60]}, decisions=100)
        >>> figure.axes[0].lines[0].get_label()
        'ours 75 %'
    """
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    axes = figure.subplots()
    times = np.arange(decisions + 1)
    for number, (name, taken) in enumerate(first.items()):
        share = success_within(taken, times)
        axes.step(
            times,
            share,
            where="post",
            color=_COLOURS[number % len(_COLOURS)],
            linestyle=_DASHES[number % len(_DASHES)],
            linewidth=1.8,
            label=f"{name} {share[-1]:.0%}".replace("%", " %"),
        )
    axes.set(
        xlabel="decisions since the episode began",
        ylabel="episodes that reached their goal",
        xlim=(0, decisions),
        ylim=(0, 1.02),
    )
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    if title:
        figure.suptitle(title, fontsize=10)
    return figure


def draw_leg(
    walked: ArrayLike,
    heading: float,
    *,
    draw: Callable[[Axes], None],
    waypoints: ArrayLike,
    edges: ArrayLike,
    planned: ArrayLike,
    cuts: ArrayLike,
    title: str = "",
) -> Figure:
    """Draw a way to the goal on the plan.

    Args:
        walked: ``[T, 2]``, where the agent was, in map units.
        heading: where it looked at first, in degrees.
        draw: draws the plan with its goal and closed slots, such as
            ``partial(draw_plan, open_mask=mask, goal=cell)``.
        waypoints: ``[W, 2]``, where the map's waypoints truly are.
        edges: int ``[E, 2]``, those of the map to draw, such as the ones that were
            walked while exploring.
        planned: int ``[K]``, the waypoints of the first plan.
        cuts: int ``[C, 2]``, the ends of what was closed on the way.
        title: over the picture.

    Returns:
        A figure of 7 x 7 inches, with no window; ``savefig`` writes it.
    """
    figure = Figure(figsize=(7, 7), layout="constrained")
    axes = figure.subplots()
    draw(axes)
    places, line = np.asarray(waypoints, float), np.asarray(walked, float)
    joined = LineCollection(
        list(places[np.asarray(edges, int).reshape(-1, 2)]),
        colors=_EDGE,
        linewidths=0.5,
        alpha=0.5,
        zorder=2.2,
        label="edge",
    )
    axes.add_collection(joined)
    x, y = places.T
    axes.scatter(x, y, s=7, c=_EDGE, zorder=2.4, label="waypoint")
    way = places[np.asarray(planned, int)]
    axes.plot(*way.T, color=_PLANNED, lw=2.4, ls="--", zorder=3.2, label="first plan")
    axes.plot(*line.T, color=AGENT, lw=1.8, alpha=0.9, zorder=3.6, label="walked")
    shut = places[np.asarray(cuts, int).reshape(-1, 2)]
    if len(shut):
        closed = LineCollection(
            list(shut), colors=_CUT, linewidths=2.2, zorder=4, label="closed on the way"
        )
        axes.add_collection(closed)
    draw_agent(axes, line[0], heading, colour=START, label="start")
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.08),
        ncols=4,
        fontsize=8,
        frameon=False,
        labelcolor=INK,
    )
    if title:
        axes.set_title(title, fontsize=10, loc="left")
    return figure
