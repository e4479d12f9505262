"""Contact sheets: first-person views beside the plan of where they were taken."""

import math
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from toponav.plotting.plan import FloorPlan
from toponav.plotting.style import CENTRED, GREY, PALETTE, new_figure

_COLOURS = (*PALETTE, "#6a3d9a", GREY)
_VIEW_HEIGHT = 1.75  # inches
_WHITE: dict[str, Any] = {"color": "white", "fontweight": "bold"}


def contact_sheet(
    views: ArrayLike,
    positions: ArrayLike,
    headings: ArrayLike,
    *,
    plan: FloorPlan,
    columns: int = 4,
) -> Figure:
    """Show views in coloured frames beside a plan with arrows of the same colours.

    Views, uint8 ``[K, H, W, 3]``, were taken at positions ``[K, 2]`` in map units with
    headings ``[K]`` in degrees.

    Examples:
        >>> views, places = np.zeros((3, 12, 16, 3), np.uint8), np.zeros((3, 2))
        >>> plan = FloorPlan(np.ones((2, 2)), cell_size=10.0)
        >>> len(contact_sheet(views, places, np.zeros(3), plan=plan).axes)
        4
    """
    images = np.asarray(views)
    places = np.asarray(positions, float)
    angles = np.asarray(headings, float).reshape(-1)
    if not len(images) or not len(images) == len(places) == len(angles):
        got = f"{len(images)}, {len(places)} and {len(angles)}"
        lists = "views, positions and headings"
        raise ValueError(f"{lists} must be as many and at least one, got {got}")
    columns = min(columns, len(images))
    rows = math.ceil(len(images) / columns)
    height, width = images.shape[1:3]
    side = max(rows * _VIEW_HEIGHT, 3.2)
    widths = [side * 1.05, columns * _VIEW_HEIGHT * width / height]
    figure = new_figure(sum(widths), side)
    left, right = figure.subfigures(1, 2, width_ratios=widths, squeeze=False)[0]
    floor = left.subplots()
    plan.draw(floor)
    grid = right.subplots(rows, columns, squeeze=False).flatten()
    for axes in grid[len(images) :]:
        axes.remove()
    marks = zip(images, places, angles, grid, cycle(_COLOURS), strict=False)
    for number, (image, place, angle, axes, colour) in enumerate(marks, start=1):
        _mark_place(floor, place, angle, number, colour)
        axes.imshow(image, interpolation="nearest")
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set(color=colour, linewidth=3.5)
        box = {"boxstyle": "round,pad=0.25", "facecolor": colour, "edgecolor": "none"}
        look: dict[str, Any] = {"va": "top", "fontsize": 9, "bbox": box, **_WHITE}
        axes.text(0.03, 0.95, str(number), transform=axes.transAxes, **look)
    return figure


def _mark_place(
    axes: Axes, place: np.ndarray, heading: float, number: int, colour: str
) -> None:
    """Draw a numbered disc with an arrow in the direction of the heading."""
    x, y = place
    tip = 19 * math.cos(math.radians(heading)), 19 * math.sin(math.radians(heading))
    arrow = {"arrowstyle": "<|-", "color": colour, "linewidth": 2.2}
    look: dict[str, Any] = {"textcoords": "offset points", "arrowprops": arrow}
    axes.annotate("", (x, y), xytext=tip, zorder=6, **look)
    axes.scatter(x, y, 130, colour, edgecolors="white", linewidths=0.8, zorder=7)
    look = CENTRED | _WHITE | {"va": "center_baseline", "fontsize": 7.5, "zorder": 8}
    axes.text(x, y, str(number), **look)


def spread_out(
    positions: ArrayLike, headings: ArrayLike, count: int, *, cell_size: float
) -> np.ndarray:
    """Choose moments of a trajectory whose places and directions lie far apart.

    Farthest-point sampling over positions ``[T, 2]`` in map units and headings ``[T]``
    in degrees: each next moment is the one farthest from all chosen so far, where
    turning around counts like walking two cells. Returns indices in the order of time.

    Examples:
        >>> spread_out([[0, 0], [1, 0], [900, 0], [500, 0]], [0] * 4, 3, cell_size=9)
        array([0, 2, 3])
    """
    places = np.asarray(positions, float)
    if not 1 <= count <= len(places):
        raise ValueError(f"count must lie in [1, {len(places)}], got {count}")
    angles = np.radians(np.asarray(headings, float).reshape(-1, 1))
    points = np.hstack([places, cell_size * np.cos(angles), cell_size * np.sin(angles)])
    chosen, distance = [0], np.full(len(points), np.inf)
    while len(chosen) < count:
        newest = np.linalg.norm(points - points[chosen[-1]], axis=1)
        distance = np.minimum(distance, newest)
        chosen.append(int(distance.argmax()))
    return np.array(sorted(chosen))
