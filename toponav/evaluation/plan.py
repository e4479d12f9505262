"""Top-down plans of a maze, drawn from its layout with matplotlib.

All positions are map units (x east, y north), the axes are labelled in cells.

- :func:`draw_plan`: walls, floor, slots, start, goal and apples.
- :func:`draw_trajectory`: a walk coloured by a value, with its colour bar.
- :func:`draw_agent`: an arrow head where an agent stands and looks.
"""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, MultipleLocator
from numpy.typing import ArrayLike
from torch import Tensor

# Okabe and Ito's colours, which colour-blind readers can tell apart.
WALL, FLOOR, INK = "#3b3f46", "#f7f5f0", "#22252a"
CLOSED, APPLE, GOAL, START, AGENT = (
    "#e69f00",
    "#d55e00",
    "#f0e442",
    "#009e73",
    "#0072b2",
)


def _value_colours() -> LinearSegmentedColormap:
    """Viridis without its brightest end, which would vanish on the floor."""
    from_viridis = ["#440154", "#414487", "#2a788e", "#22a884", "#7ad151"]
    return LinearSegmentedColormap.from_list("value", from_viridis)


#: Colours of a value along a trajectory, dark to light.
VALUE_COLOURS = _value_colours()


def draw_plan(
    axes: Axes,
    open_mask: Tensor,
    *,
    cell_size: float = 128.0,
    slots: Mapping[str, tuple[int, int]] | None = None,
    closed: Collection[str] = (),
    start: tuple[float, float, float] | None = None,
    goal: tuple[int, int] | None = None,
    apples: Sequence[tuple[int, int]] = (),
) -> None:
    """Draw a layout with what stands in it; ``axes.legend()`` names the marks.

    Args:
        axes: where to draw; its limits, ticks and aspect are set.
        open_mask: bool ``[rows, cols]``, true where the layout has floor.
        cell_size: side of a cell in map units.
        slots: row and column of each slot, by its letter.
        closed: letters of the slots that are closed.
        start: x and y in map units and heading in degrees.
        goal: row and column of the goal.
        apples: row and column of each apple.

    Raises:
        ValueError: if ``closed`` names a letter that is no slot.

    Examples:
        >>> import torch
        >>> from matplotlib.figure import Figure
        >>> axes = Figure().subplots()
        >>> mask = torch.tensor([[False, True, True, False]])
        >>> draw_plan(axes, mask, slots={"a": (0, 2)}, closed="a", goal=(0, 1))
        >>> axes.get_xlim()
        (np.float64(0.0), np.float64(512.0))
    """
    slots = {} if slots is None else slots
    if unknown := sorted(set(closed) - set(slots)):
        raise ValueError(f"closed must be among {sorted(slots)}, got {unknown}")
    floor = np.asarray(open_mask, dtype=bool)
    rows, columns = floor.shape
    _set_up_axes(axes, rows, columns, cell_size)

    def centre(cell: tuple[int, int]) -> tuple[float, float]:
        return (cell[1] + 0.5) * cell_size, (rows - cell[0] - 0.5) * cell_size

    _fill_cells(axes, floor, cell_size)
    for letter, cell in slots.items():
        _draw_slot(axes, letter, centre(cell), cell_size, is_closed=letter in closed)
    if apples:
        x, y = zip(*map(centre, apples), strict=True)
        axes.scatter(x, y, 40, APPLE, edgecolors=INK, zorder=5, label="apple")
    if goal is not None:
        axes.scatter(
            *centre(goal),
            s=170,
            c=GOAL,
            marker="*",
            edgecolors=INK,
            zorder=5,
            label="goal",
        )
    if start is not None:
        draw_agent(axes, start[:2], start[2], colour=START, label="start")


def draw_trajectory(
    axes: Axes,
    positions: ArrayLike,
    values: ArrayLike,
    *,
    label: str,
    limits: tuple[float, float] | None = None,
    jump: float = 256.0,
) -> None:
    """Draw a walk, coloured by one value per point, and its colour bar.

    Args:
        axes: of a :func:`draw_plan`.
        positions: ``[T, 2]`` in map units, ``T >= 2``.
        values: ``[T]``; a step has the colour of the point where it ends.
        label: of the colour bar: what the value is, with its unit.
        limits: values at the two ends of the colours; the extremes by default.
        jump: a step longer than this many map units is a new start within the
            episode and is not drawn.

    Raises:
        ValueError: if the shapes do not fit.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> axes = Figure().subplots()
        >>> draw_trajectory(axes, [[0, 0], [9, 0]], [0, 1], label="decision")
        >>> len(axes.collections)
        2
    """
    points, colours = np.asarray(positions, float), np.asarray(values, float)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
        raise ValueError(f"positions must be [T >= 2, 2], got {points.shape}")
    if colours.shape != points.shape[:1]:
        raise ValueError(f"values must be [{len(points)}], got {colours.shape}")
    steps = np.stack([points[:-1], points[1:]], axis=1)
    kept = np.linalg.norm(points[1:] - points[:-1], axis=1) <= jump
    casing = LineCollection(
        list(steps[kept]), colors="white", linewidths=3.6, capstyle="round", zorder=3
    )
    line = LineCollection(
        list(steps[kept]),
        cmap=VALUE_COLOURS,
        linewidths=2.0,
        capstyle="round",
        zorder=4,
    )
    line.set_array(colours[1:][kept])
    line.set_clim(*(limits or (colours.min(), colours.max())))
    axes.add_collection(casing)
    axes.add_collection(line)
    axes.figure.colorbar(line, ax=axes, label=label, fraction=0.04, pad=0.03)


def draw_agent(
    axes: Axes,
    position: ArrayLike,
    heading: float,
    *,
    colour: str = AGENT,
    label: str | None = None,
) -> None:
    """Draw an arrow head that points where the agent looks.

    Args:
        axes: of a :func:`draw_plan`.
        position: ``[2]``, x and y in map units.
        heading: degrees, 0 east, counter-clockwise.
        colour: of the arrow head.
        label: its name in the legend.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> axes = Figure().subplots()
        >>> draw_agent(axes, (64.0, 64.0), 90.0)
        >>> axes.collections[0].get_offsets().tolist()
        [[64.0, 64.0]]
    """
    x, y = np.asarray(position, float)
    turn = math.radians(heading)
    corners = np.array([[1.0, 0.0], [-0.8, 0.75], [-0.4, 0.0], [-0.8, -0.75]])
    rotation = np.array(
        [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
    )
    axes.scatter(
        x,
        y,
        s=230,
        c=colour,
        marker=MarkerStyle(corners @ rotation),
        edgecolors="white",
        linewidths=0.8,
        zorder=6,
        label=label,
    )


def _set_up_axes(axes: Axes, rows: int, columns: int, cell_size: float) -> None:
    axes.set(
        xlim=(0, columns * cell_size),
        ylim=(0, rows * cell_size),
        aspect="equal",
        facecolor=WALL,
        xlabel="x (cells)",
        ylabel="y (cells)",
    )
    every = 1 if max(rows, columns) <= 8 else math.ceil(max(rows, columns) / 16) * 2
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(every * cell_size))
        axis.set_major_formatter(FuncFormatter(lambda at, _: f"{at / cell_size:.0f}"))
    axes.tick_params(length=3, color=INK, labelsize=8)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _fill_cells(axes: Axes, floor: np.ndarray, cell_size: float) -> None:
    rows, columns = floor.shape
    extent = (0.0, columns * cell_size, 0.0, rows * cell_size)
    colours = LinearSegmentedColormap.from_list("maze", [WALL, FLOOR])
    axes.imshow(
        floor, cmap=colours, vmin=0, vmax=1, extent=extent, interpolation="nearest"
    )
    # A hair line between neighbouring cells gives the scale.
    for grid in (axes.xaxis, axes.yaxis):
        grid.set_minor_locator(MultipleLocator(cell_size))
    axes.grid(which="minor", color=WALL, alpha=0.12, linewidth=0.6)
    axes.tick_params(which="minor", length=0)


def _draw_slot(
    axes: Axes,
    letter: str,
    centre: tuple[float, float],
    cell_size: float,
    *,
    is_closed: bool,
) -> None:
    corner = (centre[0] - cell_size / 2, centre[1] - cell_size / 2)
    patch = Rectangle(corner, cell_size, cell_size, linewidth=1.4, zorder=2)
    if is_closed:
        patch.set(facecolor=CLOSED, edgecolor=INK, hatch="////")
    else:
        patch.set(facecolor="none", edgecolor=CLOSED, linestyle="--")
    axes.add_patch(patch)
    axes.text(
        *centre,
        letter,
        ha="center",
        va="center",
        zorder=5,
        color=INK,
        fontweight="bold",
        bbox={"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": "none"}
        if is_closed
        else None,
    )
