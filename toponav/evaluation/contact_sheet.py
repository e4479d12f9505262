"""Contact sheets: first-person views beside the plan of where they were taken."""

import math
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

# Okabe and Ito's colours without their yellow, which is weak on a light floor,
# and a purple and a grey; the numbers tell them apart for everybody.
_COLOURS = (
    "#d55e00",
    "#0072b2",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#6a3d9a",
    "#6b6b6b",
)


def contact_sheet(
    views: ArrayLike,
    positions: ArrayLike,
    headings: ArrayLike,
    *,
    draw: Callable[[Axes], None],
    columns: int = 4,
) -> Figure:
    """Show views in coloured frames beside a plan with arrows of the same colours.

    Args:
        views: uint8 ``[K, H, W, 3]``.
        positions: ``[K, 2]``, where they were taken, in map units.
        headings: ``[K]``, which way the agent looked, in degrees.
        draw: draws the plan, such as ``partial(draw_plan, open_mask=mask)``.
        columns: views in a row.

    Returns:
        A figure to save with ``figure.savefig(path)``.

    Raises:
        ValueError: if there is no view or the numbers of entries differ.

    Examples:
        >>> views = np.zeros((3, 12, 16, 3), np.uint8)
        >>> places, headings = np.zeros((3, 2)), np.zeros(3)
        >>> sheet = contact_sheet(views, places, headings, draw=lambda axes: None)
        >>> len(sheet.axes)  # the plan and three views
        4
    """
    images = np.asarray(views)
    places = np.asarray(positions, float)
    angles = np.asarray(headings, float).reshape(-1)
    if not len(images) or not len(images) == len(places) == len(angles):
        raise ValueError(
            "views, positions and headings must be as many and at least one, "
            f"got {len(images)}, {len(places)} and {len(angles)}"
        )
    columns = min(columns, len(images))
    rows = math.ceil(len(images) / columns)
    height, width = images.shape[1:3]
    tall = 1.75  # inches of one view
    side = max(rows * tall, 3.2)
    figure = Figure(
        figsize=(side * 1.05 + columns * tall * width / height, side),
        layout="constrained",
        dpi=120,
    )
    parts = figure.subfigures(
        1, 2, squeeze=False, width_ratios=[side * 1.05, columns * tall * width / height]
    )
    left, right = parts[0]
    plan = left.subplots()
    draw(plan)
    grid = right.subplots(rows, columns, squeeze=False).flatten()
    for number, axes in enumerate(grid):
        if number >= len(images):
            axes.remove()
            continue
        colour = _COLOURS[number % len(_COLOURS)]
        _mark_place(plan, places[number], angles[number], str(number + 1), colour)
        _show_view(axes, images[number], str(number + 1), colour)
    return figure


def _mark_place(
    axes: Axes, place: np.ndarray, heading: float, number: str, colour: str
) -> None:
    """Draw a numbered disc with an arrow that points where the agent looks."""
    ahead = math.radians(heading)
    axes.annotate(
        "",
        (place[0], place[1]),
        xytext=(19 * math.cos(ahead), 19 * math.sin(ahead)),
        textcoords="offset points",
        arrowprops={"arrowstyle": "<|-", "color": colour, "linewidth": 2.2},
        zorder=6,
    )
    axes.scatter(
        place[0], place[1], 130, colour, edgecolors="white", linewidths=0.8, zorder=7
    )
    axes.annotate(
        number,
        (place[0], place[1]),
        ha="center",
        va="center_baseline",
        fontsize=7.5,
        fontweight="bold",
        color="white",
        zorder=8,
    )


def _show_view(axes: Axes, image: np.ndarray, number: str, colour: str) -> None:
    axes.imshow(image, interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(color=colour, linewidth=3.5)
    axes.text(
        0.03,
        0.95,
        number,
        transform=axes.transAxes,
        ha="left",
        va="top",
        fontsize=9,
        fontweight="bold",
        color="white",
        bbox={"boxstyle": "round,pad=0.25", "facecolor": colour, "edgecolor": "none"},
    )


def spread_out(positions: ArrayLike, headings: ArrayLike, count: int) -> np.ndarray:
    """Choose moments of a walk whose places and directions lie far apart.

    Each next moment is the one farthest from all chosen so far, where turning
    around counts like walking 256 map units (farthest-point sampling).

    Args:
        positions: ``[T, 2]`` in map units.
        headings: ``[T]`` in degrees.
        count: how many moments, at most T.

    Returns:
        Indices, int64 ``[count]``, in the order of time.

    Raises:
        ValueError: if ``count`` is not between 1 and T.

    Examples:
        >>> spread_out([[0, 0], [1, 0], [900, 0], [500, 0]], [0, 0, 0, 0], 3)
        array([0, 2, 3])
    """
    places = np.asarray(positions, float)
    if not 1 <= count <= len(places):
        raise ValueError(f"count must lie in [1, {len(places)}], got {count}")
    angles = np.radians(np.asarray(headings, float).reshape(-1, 1))
    points = np.hstack([places, 128.0 * np.cos(angles), 128.0 * np.sin(angles)])
    chosen = [0]
    distance = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        newest = np.linalg.norm(points - points[chosen[-1]], axis=1)
        distance = np.minimum(distance, newest)
    return np.array(sorted(chosen))
