"""`FloorPlan`: a maze from above, and what is drawn on it.

Positions are map units (x east, y north); the axes are labelled in cells.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Rectangle
from matplotlib.ticker import MultipleLocator
from numpy.typing import ArrayLike, NDArray

from toponav.plotting import style

WALL, FLOOR = "#3b3f46", "#f7f5f0"
CLOSED, APPLE, GOAL = style.ORANGE, style.RED, style.YELLOW
START, AGENT = style.GREEN, style.BLUE

#: Colours of a value along a trajectory, dark to light: viridis without its brightest
#: end, which would vanish on the floor.
VALUE_COLOURS = LinearSegmentedColormap.from_list(
    "value", ["#440154", "#414487", "#2a788e", "#22a884", "#7ad151"]
)
_FLOOR_COLOURS = LinearSegmentedColormap.from_list("maze", [WALL, FLOOR])


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """A layout with what stands in it; ``axes.legend()`` names the marks.

    Examples:
        >>> mask = np.array([[False, True, True, False]])
        >>> plan = FloorPlan(mask, cell_size=10.0, slots={"a": (0, 2)}, closed="a")
        >>> draw_plan(plan).axes[0].get_xlim()
        (np.float64(0.0), np.float64(40.0))
    """

    open_mask: ArrayLike  # bool [rows, cols], true where there is floor
    _: KW_ONLY
    cell_size: float  # side of a cell in map units, `Motion.cell_size`
    # Row and column of each slot, by its letter, and which of them are closed.
    slots: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    closed: Collection[str] = ()
    start: tuple[float, float, float] | None = None  # x, y and heading in degrees
    goal: tuple[int, int] | None = None  # row and column
    apples: Sequence[tuple[int, int]] = ()

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.closed) - set(self.slots)):
            slots = sorted(self.slots)
            raise ValueError(f"closed must be among {slots}, got {unknown}")

    @property
    def floor(self) -> NDArray[np.bool_]:
        """``open_mask`` as an array."""
        return np.asarray(self.open_mask, bool)

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in map units."""
        rows, columns = self.floor.shape
        return columns * self.cell_size, rows * self.cell_size

    @property
    def jump(self) -> float:
        """A step longer than this, in map units, is a new start within the episode."""
        return 2 * self.cell_size

    def centre(self, cell: tuple[int, int]) -> tuple[float, float]:
        """Where the middle of a row and column is, in map units."""
        row, column = cell
        rows = len(self.floor)
        return (column + 0.5) * self.cell_size, (rows - row - 0.5) * self.cell_size

    def draw(self, axes: Axes) -> None:
        """Draw it; limits, ticks and aspect of the axes are set."""
        self._set_up_axes(axes)
        for letter, cell in self.slots.items():
            self._draw_slot(axes, letter, self.centre(cell))
        marks: dict[str, Any] = {"edgecolors": style.INK, "zorder": 5}
        if self.apples:
            x, y = zip(*map(self.centre, self.apples), strict=True)
            axes.scatter(x, y, 40, APPLE, label="apple", **marks)
        if self.goal is not None:
            place = self.centre(self.goal)
            axes.scatter(*place, 170, GOAL, marker="*", label="goal", **marks)
        if self.start is not None:
            draw_agent(axes, self.start[:2], self.start[2], colour=START, label="start")

    def _set_up_axes(self, axes: Axes) -> None:
        width, height = self.size
        self.show_cells(axes, self.floor, cmap=_FLOOR_COLOURS, vmin=0, vmax=1)
        axes.set(xlim=(0, width), ylim=(0, height), aspect="equal", facecolor=WALL)
        axes.set(xlabel="x (cells)", ylabel="y (cells)")
        side = max(self.floor.shape)
        every = 1 if side <= 8 else math.ceil(side / 16) * 2
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MultipleLocator(every * self.cell_size))
            axis.set_major_formatter(lambda at, _: f"{at / self.cell_size:.0f}")
            axis.set_minor_locator(MultipleLocator(self.cell_size))
        # A hair line between neighbouring cells gives the scale.
        axes.grid(which="minor", color=WALL, alpha=0.12, linewidth=0.6)
        axes.tick_params(which="minor", length=0)
        axes.tick_params(length=3, color=style.INK, labelsize=8)
        axes.spines[:].set_visible(False)

    def show_cells(self, axes: Axes, values: ArrayLike, **look: Any) -> AxesImage:
        """Show one value a cell, ``[rows, cols]``."""
        width, height = self.size
        extent = (0, width, 0, height)
        return axes.imshow(values, extent=extent, interpolation="nearest", **look)

    def _draw_slot(self, axes: Axes, letter: str, centre: tuple[float, float]) -> None:
        side, box = self.cell_size, None
        look: dict[str, Any] = {"fc": "none", "ec": CLOSED, "ls": "--"}
        if letter in self.closed:
            look = {"fc": CLOSED, "ec": style.INK, "hatch": "////"}
            box = {"boxstyle": "circle,pad=0.15", "fc": "white", "ec": "none"}
        corner = (centre[0] - side / 2, centre[1] - side / 2)
        axes.add_patch(Rectangle(corner, side, side, lw=1.4, zorder=2, **look))
        look = {"color": style.INK, "weight": "bold", "zorder": 5, "bbox": box}
        axes.text(*centre, letter, style.CENTRED, **look)


def figure_of_plan(
    plan: FloorPlan | None, size: tuple[float, float], title: str
) -> tuple[Figure, Axes]:
    """A figure of one panel, in inches, that shows the plan."""
    figure = style.new_figure(*size)
    axes = figure.subplots()
    if plan is not None:
        plan.draw(axes)
    style.add_heading(axes, title)
    return figure, axes


def draw_plan(plan: FloorPlan, *, title: str = "") -> Figure:
    """Draw a plan alone, its marks named on its right."""
    figure, axes = figure_of_plan(plan, (7, 6), title)
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False)
    return figure


def draw_trajectory(
    axes: Axes,
    positions: ArrayLike,
    values: ArrayLike,
    *,
    label: str,
    jump: float,
    limits: tuple[float, float],
) -> None:
    """Draw a trajectory ``[T, 2]``, coloured by a value per point, and its colour bar.

    A step has the colour of the point where it ends; steps longer than ``jump`` map
    units are not drawn. ``limits`` are the values at the two ends of the colours.
    """
    points = np.asarray(positions, float)
    steps = np.stack([points[:-1], points[1:]], axis=1)
    kept = np.linalg.norm(np.diff(points, axis=0), axis=1) <= jump
    drawn = list(steps[kept])
    casing = LineCollection(drawn, colors="white", lw=3.6, zorder=3, capstyle="round")
    line = LineCollection(drawn, cmap=VALUE_COLOURS, lw=2, zorder=4, capstyle="round")
    line.set(array=np.asarray(values)[1:][kept], clim=limits)
    axes.add_collection(casing)
    axes.add_collection(line)
    axes.figure.colorbar(line, ax=axes, label=label, fraction=0.04, pad=0.03)


def draw_agent(
    axes: Axes, position: ArrayLike, heading: float, *, colour: str, label: str
) -> None:
    """Draw an arrow head at x and y in map units; heading 0 is east, 90 north."""
    cos, sin = math.cos(math.radians(heading)), math.sin(math.radians(heading))
    corners = np.array([[1.0, 0.0], [-0.8, 0.75], [-0.4, 0.0], [-0.8, -0.75]])
    marker = MarkerStyle(corners @ [[cos, sin], [-sin, cos]])
    look: dict[str, Any] = {"edgecolors": "white", "linewidths": 0.8, "zorder": 6}
    x, y = np.asarray(position, float)
    axes.scatter(x, y, s=230, c=colour, marker=marker, label=label, **look)
