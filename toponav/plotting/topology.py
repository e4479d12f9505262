"""A topological map, drawn on the plan or, without one, by its edges alone.

Dots, lines and headings of a large map would hide all that is below them. So each kind
gets a share of the floor, and its marks become smaller or paler to fit.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.offsetbox import AnnotationBbox, OffsetImage
from numpy.typing import ArrayLike
from torch import Tensor

from toponav.plotting import style
from toponav.plotting.graph_layout import lay_out
from toponav.plotting.plan import FloorPlan, figure_of_plan

# Size of a view in a graph, and the least distance of two, of the graph being 1.
_VIEW_POINTS, _VIEW_SHARE = 46.0, 0.14
# In inches; the longer side of what is drawn, in points.
_SIZE, _SIDE = (8.6, 8.2), 500.0
# Most that dots, lines of a kind and headings may cover of the floor, in shares; where
# lines cross, less of it is hidden.
_DOTS, _LINES, _HEADINGS = 0.2, 0.5, 0.12
# Palest and clearest lines, and width of headings in points.
_PALEST, _CLEAREST, _HEADING = 0.08, 0.8, 0.5
# The largest dot, in square points, and the width of its rim.
_LARGEST, _RIM = 22.0, 0.6
# From so many marks on, a vector graphic holds them as a picture.
_MANY = 2_000


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

    Poses are ``[W, 3]``, x and y in map units and heading in degrees. Edges, int64
    ``[E, 2]``, of a cost ``[E]`` above 1 were never walked; those with ends far apart
    are ``spurious``, bool ``[E]``. Of very many waypoints no headings are drawn.
    """
    figure, axes = figure_of_plan(plan, _SIZE, title)
    places = np.asarray(poses, float)
    # Points of a map unit, and the floor's square points.
    scale = _SIDE / max(plan.size)
    room = float(plan.floor.sum()) * (scale * plan.cell_size) ** 2
    ends = places[np.asarray(edges).reshape(-1, 2), :2]
    _draw_edges(axes, ends, edge_cost, np.asarray(spurious), scale=scale, room=room)
    reach, label = 0.14 * plan.cell_size, f"{len(places):,} waypoints"
    if len(places) * reach * scale * _HEADING <= _HEADINGS * room:
        turn = np.deg2rad(places[:, 2])
        tips = places[:, :2] + reach * np.stack([np.cos(turn), np.sin(turn)], 1)
        shown = np.stack([places[:, :2], tips], 1)
        style.add_lines(axes, shown, style.INK, _HEADING, zorder=4)
        label += " with their headings"
    _draw_dots(axes, places, label, room=room)
    _add_legend(axes, 0.08)
    return figure


def draw_graph(
    num_waypoints: int,
    edges: Tensor,
    edge_cost: Tensor,
    *,
    find_views: Callable[[list[int]], Mapping[int, np.ndarray]] | None = None,
    title: str = "",
) -> Figure:
    """Draw a map without ground truth: a layout computed from its edges alone.

    Arguments are as for `draw_topological_map`; ``find_views`` returns views, uint8
    ``[H, W, 3]``, of the waypoints whose numbers it gets, to be shown where they are.

    Examples:
        >>> import torch
        >>> figure = draw_graph(2, torch.tensor([[0, 1]]), torch.ones(1))
        >>> [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
        ['1 edge walked', '2 waypoints']
    """
    places = lay_out(num_waypoints, edges)
    figure, axes = figure_of_plan(None, _SIZE, title)
    side = max(np.ptp(places, axis=0).max(initial=0.0), 1e-9) if num_waypoints else 1.0
    # A layout fills about half of the square around it.
    scale, room = _SIDE / side, _SIDE**2 / 2
    ends = places[np.asarray(edges).reshape(-1, 2)]
    none = np.zeros(len(edges), bool)
    _draw_edges(axes, ends, edge_cost, none, scale=scale, room=room)
    _draw_dots(axes, places, f"{num_waypoints:,} waypoints", room=room)
    if find_views is not None and num_waypoints:
        shown = _far_apart(places, np.unique(edges) if len(edges) else None)
        for number, view in find_views(shown).items():
            _show_view(axes, places[number], view)
        # Room for the views at the edge.
        axes.margins(0.06, 0.12)
    axes.set_axis_off()
    _add_legend(axes, 0.02)
    return figure


def _add_legend(axes: Axes, distance: float) -> None:
    style.add_legend_below(axes, distance)
    legend = axes.get_legend()
    assert legend is not None
    for handle in legend.legend_handles:
        # A mark alone, as thin, pale or small as its many, would not be seen.
        if isinstance(handle, Line2D):
            handle.set(color=to_rgb(handle.get_color()), linewidth=style.LINE)
        elif isinstance(handle, PathCollection):
            handle.set(sizes=[_LARGEST], linewidths=_RIM)


def _draw_dots(axes: Axes, places: np.ndarray, label: str, *, room: float) -> None:
    """A dot a waypoint, with a rim as wide as a quarter of it at most."""
    num = max(len(places), 1)
    # Of a dot of size s, s square points and its rim are covered.
    most = _DOTS * room / (num * np.pi / 4 * 1.25**2)
    size = float(np.clip(300 / np.sqrt(num), 0.5, min(_LARGEST, max(most, 0.5))))
    rim = min(_RIM, 0.25 * size**0.5)
    many = len(places) > _MANY
    style.add_dots(axes, places, size, label, linewidths=rim, rasterized=many)


def _draw_edges(
    axes: Axes,
    ends: np.ndarray,
    cost: Tensor,
    spurious: np.ndarray,
    *,
    scale: float,
    room: float,
) -> None:
    """Lines between ends ``[E, 2, 2]``; a unit has ``scale`` points."""
    walked = np.asarray(cost) <= 1
    length = scale * np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    # Many edges hide the plan: the more there are, the thinner and paler they are.
    thin = float(np.clip(40 / np.sqrt(max(len(ends), 1)), 0.35, 1.6))
    for some, colour, width, name, order in (
        (~walked & ~spurious, style.SKY, 0.6 * thin, "only seen", 3.0),
        (walked & ~spurious, style.BLUE, thin, "walked", 3.0),
        # Few, and what one looks for.
        (spurious, style.RED, max(1.3 * thin, 0.9), "spurious", 4.5),
    ):
        if some.any():
            num = int(some.sum())
            label = f"{num:,} edge{'s' * (num != 1)} {name}"
            covered = float(length[some].sum()) * width / room
            look: dict[str, Any] = {"label": label, "zorder": order}
            alpha = np.clip(_LINES / max(covered, 1e-9), _PALEST, _CLEAREST)
            look["alpha"] = float(alpha)
            look["rasterized"] = num > _MANY
            style.add_lines(axes, ends[some], colour, width, **look)


def _far_apart(places: np.ndarray, among: ArrayLike | None) -> list[int]:
    """Numbers of places ``[W, 2]`` that leave room for a view each.

    ``among`` are those to choose from, all unless given.
    """
    numbers = np.arange(len(places)) if among is None else np.asarray(among)
    points = places[numbers]
    room = _VIEW_SHARE * max(np.ptp(places, axis=0).max(), 1e-9)
    chosen = [int(np.linalg.norm(points - points.mean(0), axis=1).argmax())]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while distance.max() >= room:
        chosen.append(int(distance.argmax()))
        newest = np.linalg.norm(points - points[chosen[-1]], axis=1)
        distance = np.minimum(distance, newest)
    return [int(number) for number in numbers[chosen]]


def _show_view(axes: Axes, place: np.ndarray, view: np.ndarray) -> None:
    """A view in a thin frame beside its waypoint."""
    zoom = _VIEW_POINTS / max(view.shape[:2])
    image = OffsetImage(view, zoom=zoom, interpolation="nearest")
    box = {"edgecolor": style.INK, "linewidth": 0.6}
    arrow = {"arrowstyle": "-", "color": style.INK, "linewidth": 0.6}
    shown = AnnotationBbox(
        image,
        (place[0], place[1]),
        xybox=(0, 0.62 * _VIEW_POINTS),
        boxcoords="offset points",
        pad=0.05,
        bboxprops=box,
        arrowprops=arrow,
        zorder=6,
    )
    axes.add_artist(shown)
