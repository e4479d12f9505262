"""What an agent did, drawn on the plan: an episode, a path to the goal."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import ArrayLike

from toponav.metrics import EpisodeTrace, effective_cells, occupancy
from toponav.plotting import style
from toponav.plotting.plan import (
    AGENT,
    START,
    FloorPlan,
    draw_agent,
    draw_trajectory,
    figure_of_plan,
)

WAYPOINT, SPURIOUS = style.WHITE, style.RED
_EDGE, _CUT = "#8c9bab", "#c1121f"
# From a light blue that a visited cell has at least, to black.
_TIMES = ["#d6e6f2", style.SKY, style.BLUE, "#12263a"]


def reward_limits(reward: ArrayLike) -> tuple[float, float]:
    """Rewards at the dark and the light end of a trail: 0 and the 98 % quantile."""
    values = np.asarray(reward, np.float64)
    low = min(0.0, float(values.min()))
    # The few largest would leave all others one colour.
    high = float(np.quantile(values, 0.98))
    return (low, high) if high > low else (low, low + 1.0)


def draw_exploration(trace: EpisodeTrace, plan: FloorPlan) -> Figure:
    """Draw a trajectory coloured by its reward, and time per cell.

    Waypoints are drawn and counted where the episode has any.
    """
    figure = style.new_figure(12.5, 5.6)
    left, right = figure.subplots(1, 2)
    plan.draw(left)
    reward, limits = trace.reward, reward_limits(trace.reward)
    label = "reward learned from (lightest: the highest 2 %)"
    look: dict[str, Any] = {"label": label, "limits": limits, "jump": plan.jump}
    draw_trajectory(left, trace.positions, reward, **look)
    title = f"{len(trace) - 1:,} decisions: coverage {trace.coverage[-1]:.0%}, "
    title += f"return {trace.reward.sum():.1f}"
    if trace.is_new_waypoint.any():
        spurious = trace.is_new_waypoint & trace.spurious_waypoint
        sound = trace.positions[trace.is_new_waypoint & ~spurious]
        style.add_dots(left, sound, 26, "waypoint")
        look = {"marker": "X", "c": SPURIOUS, "edgecolors": "white"}
        style.add_dots(left, trace.positions[spurious], 42, "spurious waypoint", **look)
        # The first waypoint, which every episode has, cannot be spurious.
        new, later = trace.is_new_waypoint.sum(), trace.is_new_waypoint[1:].sum()
        wrong = trace.spurious_waypoint[1:].sum()
        title += f";\n{new} waypoints, {wrong} of {later} new ones spurious"
    draw_agent(left, trace.positions[0], trace.headings[0], colour=START, label="start")
    draw_agent(left, trace.positions[-1], trace.headings[-1], colour=AGENT, label="end")
    style.add_heading(left, title)
    style.add_legend_below(left)
    plan.draw(right)
    _draw_occupancy(right, trace.cells, plan)
    return figure


def _draw_occupancy(axes: Axes, cells: np.ndarray, plan: FloorPlan) -> None:
    """Shares of the time; cells that were never visited stay white and hatched."""
    floor, (width, height) = plan.floor, plan.size
    rows, columns = floor.shape
    share = occupancy(cells, (rows, columns))
    colours = LinearSegmentedColormap.from_list("time", _TIMES)
    seen = np.ma.masked_equal(share, 0)
    image = plan.show_cells(axes, seen, cmap=colours, vmin=0, zorder=2.5)
    x, y = np.linspace(0, width, columns + 1), np.linspace(height, 0, rows + 1)
    never = np.ma.masked_equal(floor & (share == 0), False)
    look: dict[str, Any] = {"hatch": "////", "edgecolor": "#b9bcc2", "linewidth": 0}
    axes.pcolor(x, y, never, cmap=ListedColormap(["white"]), zorder=2.5, **look)
    look = {"label": "share of the time", "fraction": 0.04, "pad": 0.03}
    axes.figure.colorbar(image, ax=axes, format=PercentFormatter(1.0), **look)
    busiest = np.sort(share, axis=None)[-5:].sum()
    style.add_heading(
        axes,
        f"{(share > 0).sum()} of {floor.sum()} cells visited (hatched: never), "
        f"time spread as over {effective_cells(share):.0f};\n"
        f"the five busiest hold {busiest:.0%} of {len(cells):,} observations",
    )


def draw_leg(
    walked: ArrayLike,
    heading: float,
    *,
    plan: FloorPlan,
    waypoints: ArrayLike,
    edges: ArrayLike,
    planned: ArrayLike,
    cuts: ArrayLike,
    title: str = "",
) -> Figure:
    """Draw an agent's path to the goal, with the map that it was planned on.

    It ``walked`` ``[T, 2]``, in map units, and looked along ``heading``, in degrees, at
    first. ``waypoints`` ``[W, 2]`` are the true positions of the map's, ``edges`` int
    ``[E, 2]`` those to draw, ``planned`` int ``[K]`` the waypoints of the first plan
    and ``cuts`` int ``[C, 2]`` the ends of edges that were closed along the path.
    """
    figure, axes = figure_of_plan(plan, (7, 7), title)
    places, path = np.asarray(waypoints, float), np.asarray(walked, float)
    joined = places[np.asarray(edges, int).reshape(-1, 2)]
    style.add_lines(axes, joined, _EDGE, 0.5, label="edge", zorder=2.2)
    style.add_dots(axes, places, 7, "waypoint", c=_EDGE, edgecolors=_EDGE, zorder=2.4)
    first = places[np.asarray(planned, int)]
    axes.plot(*first.T, "--", c=style.GREEN, lw=2.4, zorder=3.2, label="first plan")
    axes.plot(*path.T, color=AGENT, lw=1.8, alpha=0.9, zorder=3.6, label="walked")
    closed = places[np.asarray(cuts, int).reshape(-1, 2)]
    if len(closed):
        style.add_lines(axes, closed, _CUT, 2.2, label="edge cut on the path", zorder=4)
    draw_agent(axes, path[0], heading, colour=START, label="start")
    style.add_legend_below(axes)
    return figure
