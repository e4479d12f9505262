"""Figures of a topological map: alone, and with a path to the goal."""

import networkx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from torch import Tensor

from toponav.plotting.plan import AGENT, START, FloorPlan, draw_agent, figure_of_plan
from toponav.plotting.style import (
    BLUE,
    GREEN,
    INK,
    RED,
    SKY,
    add_dots,
    add_legend_below,
    add_lines,
)

_WALKED, _SEEN, _SPURIOUS = BLUE, SKY, RED
_EDGE, _CUT = "#8c9bab", "#c1121f"
# Enough to unfold some hundred waypoints in a second.
_LAYOUT_ITERATIONS = 60


def draw_topological_map(
    poses: Tensor,
    edges: Tensor,
    edge_cost: Tensor,
    spurious: Tensor,
    *,
    plan: FloorPlan,
    title: str = "",
) -> Figure:
    """Draw a map where its waypoints were seen.

    Args:
        poses: ``[W, 3]``, x and y in map units and heading in degrees.
        edges: int64 ``[E, 2]``.
        edge_cost: ``[E]``; edges above 1 were never walked.
        spurious: bool ``[E]``, the edges whose ends are far apart.
        plan: of the maze.
        title: over the picture.
    """
    if not len(edges) == len(edge_cost) == len(spurious):
        raise ValueError(
            "edges, edge_cost and spurious must have one length, got "
            f"{len(edges)}, {len(edge_cost)} and {len(spurious)}"
        )
    figure, axes = figure_of_plan(plan, (8.6, 8.2), title)
    places = np.asarray(poses, float)
    _draw_edges(axes, places[:, :2], edges, edge_cost, np.asarray(spurious))
    turn, reach = np.deg2rad(places[:, 2]), 0.14 * plan.cell_size
    tips = places[:, :2] + reach * np.stack([np.cos(turn), np.sin(turn)], 1)
    add_lines(axes, np.stack([places[:, :2], tips], 1), INK, 0.5, zorder=4)
    size = float(np.clip(300 / np.sqrt(max(len(places), 1)), 3, 22))
    add_dots(axes, places, size, f"{len(places):,} waypoints with their headings")
    add_legend_below(axes)
    return figure


def draw_graph(
    num_waypoints: int, edges: Tensor, edge_cost: Tensor, *, title: str = ""
) -> Figure:
    """Draw a map without ground truth: a layout computed from its edges alone.

    Arguments are as for `draw_topological_map`.

    Examples:
        >>> import torch
        >>> figure = draw_graph(2, torch.tensor([[0, 1]]), torch.ones(1))
        >>> [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
        ['1 edges walked', '2 waypoints']
    """
    graph = networkx.empty_graph(num_waypoints)
    graph.add_edges_from(edges.tolist())
    layout = networkx.spring_layout(graph, iterations=_LAYOUT_ITERATIONS, seed=0)
    places = np.array(list(layout.values())).reshape(-1, 2)
    figure, axes = figure_of_plan(None, (8.6, 8.2), title)
    _draw_edges(axes, places, edges, edge_cost, np.zeros(len(edges), bool))
    add_dots(axes, places, 14, f"{num_waypoints:,} waypoints")
    axes.set_axis_off()
    add_legend_below(axes, 0.02)
    return figure


def _draw_edges(
    axes: Axes, places: np.ndarray, edges: Tensor, cost: Tensor, spurious: np.ndarray
) -> None:
    ends = places[np.asarray(edges).reshape(-1, 2)]
    walked = np.asarray(cost) <= 1
    # Many edges hide the plan: the more there are, the thinner they are.
    thin = float(np.clip(40 / np.sqrt(max(len(edges), 1)), 0.35, 1.6))
    for some, colour, width, name in (
        (~walked & ~spurious, _SEEN, 0.6 * thin, "only seen"),
        (walked & ~spurious, _WALKED, thin, "walked"),
        (spurious, _SPURIOUS, 1.3 * thin, "spurious"),
    ):
        if some.any():
            label = f"{some.sum():,} edges {name}"
            add_lines(axes, ends[some], colour, width, label=label)


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

    Args:
        walked: ``[T, 2]``, where the agent was, in map units.
        heading: where it looked at first, in degrees.
        plan: of the maze, with its goal and closed slots.
        waypoints: ``[W, 2]``, the true positions of the map's waypoints.
        edges: int ``[E, 2]``, the map's edges to draw.
        planned: int ``[K]``, the waypoints of the first plan.
        cuts: int ``[C, 2]``, the ends of edges that were closed along the path.
        title: over the picture.
    """
    figure, axes = figure_of_plan(plan, (7, 7), title)
    places, path = np.asarray(waypoints, float), np.asarray(walked, float)
    joined = places[np.asarray(edges, int).reshape(-1, 2)]
    add_lines(axes, joined, _EDGE, 0.5, label="edge", zorder=2.2)
    add_dots(axes, places, 7, "waypoint", colour=_EDGE, edge=_EDGE, zorder=2.4)
    first = places[np.asarray(planned, int)]
    axes.plot(*first.T, color=GREEN, lw=2.4, ls="--", zorder=3.2, label="first plan")
    axes.plot(*path.T, color=AGENT, lw=1.8, alpha=0.9, zorder=3.6, label="walked")
    closed = places[np.asarray(cuts, int).reshape(-1, 2)]
    if len(closed):
        add_lines(axes, closed, _CUT, 2.2, label="edge cut on the path", zorder=4)
    draw_agent(axes, path[0], heading, colour=START, label="start")
    add_legend_below(axes)
    return figure
