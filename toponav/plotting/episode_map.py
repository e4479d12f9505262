"""`draw_exploration`: an episode on the plan, and where the time went."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import ArrayLike

from toponav.metrics import EpisodeTrace, effective_cells, occupancy
from toponav.plotting.plan import AGENT, START, FloorPlan, draw_agent, draw_trajectory
from toponav.plotting.style import (
    BLUE,
    RED,
    SKY,
    WHITE,
    add_dots,
    add_heading,
    add_legend_below,
    new_figure,
)

WAYPOINT, SPURIOUS = WHITE, RED
# From a light blue that a visited cell has at least, to black.
_TIME_COLOURS = LinearSegmentedColormap.from_list(
    "time", ["#d6e6f2", SKY, BLUE, "#12263a"]
)
# The few largest rewards of an episode would leave all others one colour.
_BRIGHTEST = 0.98


def reward_limits(reward: ArrayLike) -> tuple[float, float]:
    """Rewards at the dark and the light end of a trail: 0 and the 98 % quantile."""
    values = np.asarray(reward, np.float64)
    low = min(0.0, float(values.min()))
    high = float(np.quantile(values, _BRIGHTEST))
    return (low, high) if high > low else (low, low + 1.0)


def draw_exploration(
    trace: EpisodeTrace,
    plan: FloorPlan,
    *,
    visited: ArrayLike | None = None,
    title: str = "",
) -> Figure:
    """Draw a trajectory coloured by its reward with its waypoints, and time per cell.

    Args:
        trace: the episode.
        plan: of the maze.
        visited: int ``[*, 2]``, cells of the right panel, by default of ``trace``.
        title: over the picture.
    """
    figure = new_figure(12.5, 5.6, title=title)
    left, right = figure.subplots(1, 2)
    plan.draw(left)
    draw_trajectory(
        left,
        trace.positions,
        trace.reward,
        label="intrinsic reward (lightest: the highest 2 %)",
        limits=reward_limits(trace.reward),
        jump=plan.jump,
    )
    spurious = trace.is_new_waypoint & trace.spurious_waypoint
    sound = trace.is_new_waypoint & ~trace.spurious_waypoint
    add_dots(left, trace.positions[sound], 26, "waypoint")
    red: dict[str, Any] = {"marker": "X", "colour": SPURIOUS, "edge": "white"}
    add_dots(left, trace.positions[spurious], 42, "spurious waypoint", **red)
    draw_agent(left, trace.positions[0], trace.headings[0], colour=START, label="start")
    draw_agent(left, trace.positions[-1], trace.headings[-1], colour=AGENT, label="end")
    # The first waypoint, which every episode has, cannot be spurious.
    new, later = trace.is_new_waypoint.sum(), trace.is_new_waypoint[1:].sum()
    wrong = trace.spurious_waypoint[1:].sum()
    add_heading(
        left,
        f"{len(trace) - 1:,} decisions: coverage {trace.coverage[-1]:.0%}, "
        f"return {trace.reward.sum():.1f};\n"
        f"{new} waypoints, {wrong} of {later} new ones spurious",
    )
    add_legend_below(left)
    plan.draw(right)
    cells = trace.cells if visited is None else np.asarray(visited)
    _draw_occupancy(right, cells, plan)
    return figure


def _draw_occupancy(axes: Axes, cells: np.ndarray, plan: FloorPlan) -> None:
    """Shares of the time; cells that were never visited stay white and hatched."""
    floor, (width, height) = plan.floor, plan.size
    rows, columns = floor.shape
    share = occupancy(cells, (rows, columns))
    seen = np.ma.masked_where(share == 0, share)
    look: dict[str, Any] = {"vmin": 0, "zorder": 2.5}
    image = plan.show_cells(axes, seen, cmap=_TIME_COLOURS, **look)
    never = floor & (share == 0)
    axes.pcolor(
        np.linspace(0, width, columns + 1),
        np.linspace(height, 0, rows + 1),
        np.ma.masked_where(~never, never),
        cmap=ListedColormap(["white"]),
        hatch="////",
        edgecolor="#b9bcc2",
        linewidth=0,
        zorder=2.5,
    )
    bar: dict[str, Any] = {"label": "share of the time", "fraction": 0.04, "pad": 0.03}
    axes.figure.colorbar(image, ax=axes, format=PercentFormatter(1.0), **bar)
    busiest = np.sort(share, axis=None)[-5:].sum()
    add_heading(
        axes,
        f"{(share > 0).sum()} of {floor.sum()} cells visited (hatched: never), "
        f"time spread as over {effective_cells(share):.0f};\n"
        f"the five busiest hold {busiest:.0%} of {len(cells):,} observations",
    )
