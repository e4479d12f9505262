"""`draw_exploration`: an episode on the plan, and where the time went."""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import ArrayLike
from torch import Tensor

from toponav.evaluation.diagnostics import effective_cells, occupancy
from toponav.evaluation.episode_trace import EpisodeTrace
from toponav.evaluation.plan import AGENT, INK, START, draw_agent, draw_trajectory

#: Marks of waypoints: white where they are sound, red where they are false.
WAYPOINT, FALSE_WAYPOINT = "#ffffff", "#d55e00"
# The few largest rewards of an episode would leave all others one colour.
_BRIGHTEST = 0.98


def reward_limits(reward: ArrayLike) -> tuple[float, float]:
    """Rewards at the dark and the light end of a trail: 0 and the 98 % quantile.

    Examples:
        >>> reward_limits([0.0] * 50 + [1.0] * 50)
        (0.0, 1.0)
        >>> reward_limits([0.0, 0.0])
        (0.0, 1.0)
    """
    values = np.asarray(reward, np.float64)
    low = min(0.0, float(values.min()))
    high = float(np.quantile(values, _BRIGHTEST))
    return (low, high) if high > low else (low, low + 1.0)


def draw_exploration(
    trace: EpisodeTrace,
    open_mask: Tensor,
    *,
    draw: Callable[[Axes], None],
    visited: ArrayLike | None = None,
    title: str = "",
) -> Figure:
    """Draw a walk coloured by its reward with its waypoints, and the time per cell.

    Args:
        trace: the episode.
        open_mask: bool ``[rows, cols]``, true where the layout has floor.
        draw: draws the plan, such as ``partial(draw_plan, open_mask=open_mask)``.
        visited: int ``[*, 2]``, the cells of which the right panel shows the shares,
            such as those of many episodes; those of ``trace`` by default.
        title: over the picture.

    Returns:
        A figure of 12.5 x 5.6 inches, with no window; ``savefig`` writes it.

    Raises:
        ValueError: as `occupancy`.
    """
    figure = Figure(figsize=(12.5, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw(left)
    draw_trajectory(
        left,
        trace.positions,
        trace.reward,
        label="intrinsic reward (lightest: the highest 2 %)",
        limits=reward_limits(trace.reward),
    )
    _draw_waypoints(left, trace)
    draw_agent(left, trace.positions[0], trace.headings[0], colour=START, label="start")
    draw_agent(left, trace.positions[-1], trace.headings[-1], colour=AGENT, label="end")
    left.set_title(
        f"{len(trace) - 1:,} decisions: coverage {trace.coverage[-1]:.0%}, "
        f"return {trace.reward.sum():.1f};\n{trace.born.sum()} waypoints, "
        f"{trace.false_birth[1:].sum()} of {trace.born[1:].sum()} births false",
        fontsize=10,
        loc="left",
    )
    left.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=4,
        fontsize=8,
        frameon=False,
    )
    draw(right)
    cells = trace.cells if visited is None else np.asarray(visited)
    _draw_occupancy(right, cells, np.asarray(open_mask, bool))
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def _draw_waypoints(axes: Axes, trace: EpisodeTrace) -> None:
    false = trace.born & trace.false_birth
    sound = trace.born & ~trace.false_birth
    marks = (
        (sound, "o", WAYPOINT, INK, 26, "waypoint"),
        (false, "X", FALSE_WAYPOINT, "white", 42, "false birth"),
    )
    for born, shape, colour, edge, size, name in marks:
        x, y = trace.positions[born].T
        axes.scatter(
            x,
            y,
            s=size,
            c=colour,
            marker=shape,
            edgecolors=edge,
            linewidths=0.9,
            zorder=5,
            label=name,
        )


def _draw_occupancy(axes: Axes, cells: np.ndarray, floor: np.ndarray) -> None:
    """Shares of the time; cells that were never visited stay white and hatched."""
    share = occupancy(cells, (floor.shape[0], floor.shape[1]))
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    extent = (left, right, low, high)
    # From a light blue that a visited cell has at least, to black.
    colours = LinearSegmentedColormap.from_list(
        "time", ["#d6e6f2", "#56b4e9", "#0072b2", "#12263a"]
    )
    shown = np.ma.masked_where(share == 0, share)
    image = axes.imshow(
        shown, cmap=colours, vmin=0, extent=extent, interpolation="nearest", zorder=2.5
    )
    never = floor & (share == 0)
    edges = [np.linspace(left, right, floor.shape[1] + 1)]
    edges.append(np.linspace(high, low, floor.shape[0] + 1))
    axes.pcolor(
        *edges,
        np.ma.masked_where(~never, never),
        cmap=ListedColormap(["white"]),
        hatch="////",
        edgecolor="#b9bcc2",
        linewidth=0,
        zorder=2.5,
    )
    bar = axes.figure.colorbar(
        image, ax=axes, label="share of the time", fraction=0.04, pad=0.03
    )
    bar.ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    busiest = np.sort(share, axis=None)[-5:].sum()
    visited = f"{(share > 0).sum()} of {floor.sum()} cells visited (hatched: never)"
    spread = f"time spread as over {effective_cells(share):.0f}"
    axes.set_title(
        f"{visited}, {spread};\nthe five busiest hold {busiest:.0%} of "
        f"{len(cells):,} observations",
        fontsize=10,
        loc="left",
    )
