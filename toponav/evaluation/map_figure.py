"""`draw_topological_map`: a map over the plan, its false edges in another colour."""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from torch import Tensor

from toponav.evaluation.plan import INK

#: Colours of edges: walked, only seen, false. Readable without colour by their width.
WALKED, SEEN, FALSE = "#0072b2", "#56b4e9", "#d55e00"
_NODE = "#ffffff"


def draw_topological_map(
    poses: Tensor,
    edges: Tensor,
    edge_cost: Tensor,
    false: Tensor,
    *,
    draw: Callable[[Axes], None],
    title: str = "",
) -> Figure:
    """Draw waypoints where they were seen, with the way they look, and all edges.

    Args:
        poses: ``[W, 3]``, x and y in map units and heading in degrees.
        edges: int64 ``[E, 2]``.
        edge_cost: ``[E]``; edges above 1 were never walked.
        false: bool ``[E]``, the edges whose ends are far apart.
        draw: draws the plan, such as ``partial(draw_plan, open_mask=open_mask)``.
        title: over the picture.

    Returns:
        A figure with no window; ``savefig`` writes it.

    Raises:
        ValueError: if the edges' numbers do not have one length.

    Shape notation:
        W: waypoints.  E: edges.
    """
    if not len(edges) == len(edge_cost) == len(false):
        raise ValueError(
            "edges, edge_cost and false must have one length, got "
            f"{len(edges)}, {len(edge_cost)} and {len(false)}"
        )
    figure = Figure(figsize=(8.6, 8.2), layout="constrained")
    axes = figure.subplots()
    draw(axes)
    at = np.asarray(poses, float)
    lines = np.stack([at[edges[:, 0], :2], at[edges[:, 1], :2]], 1)
    walked, wrong = np.asarray(edge_cost) <= 1, np.asarray(false)
    # Many edges hide the plan: the more there are, the thinner they are.
    thin = float(np.clip(40 / np.sqrt(max(len(edges), 1)), 0.35, 1.6))
    for some, colour, width, name in (
        (~walked & ~wrong, SEEN, 0.6 * thin, "only seen"),
        (walked & ~wrong, WALKED, thin, "walked"),
        (wrong, FALSE, 1.3 * thin, "false"),
    ):
        if some.any():
            label = f"{some.sum():,} edges {name}"
            axes.add_collection(
                LineCollection(
                    list(lines[some]),
                    colors=colour,
                    linewidths=width,
                    alpha=0.7,
                    zorder=3,
                    label=label,
                )
            )
    _draw_waypoints(axes, at)
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.07),
        ncols=4,
        fontsize=9,
        frameon=False,
    )
    if title:
        axes.set_title(title, fontsize=11, loc="left")
    return figure


def _draw_waypoints(axes: Axes, poses: np.ndarray) -> None:
    """A dot for each, with a short line the way it looks."""
    turn = np.deg2rad(poses[:, 2])
    size = float(np.clip(300 / np.sqrt(max(len(poses), 1)), 3, 22))
    tips = poses[:, :2] + 18 * np.stack([np.cos(turn), np.sin(turn)], 1)
    looks = np.stack([poses[:, :2], tips], 1)
    axes.add_collection(
        LineCollection(list(looks), colors=INK, linewidths=0.5, zorder=4)
    )
    axes.scatter(
        poses[:, 0],
        poses[:, 1],
        s=size,
        c=_NODE,
        edgecolors=INK,
        linewidths=0.5,
        zorder=5,
        label=f"{len(poses):,} waypoints, looking along the line",
    )
