"""What one episode puts into a maze: start, apples, goal, closed slots."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from toponav.envs.layout import Cell, Layout

# Starts, apples and goals stand up to this share of a cell off its centre.
_JITTER = 0.2


class Pose(NamedTuple):
    """A position (x east, y north, in map units) and a direction."""

    x: float
    y: float
    heading: float  # degrees counter-clockwise from east, in [0, 360)


@dataclass(frozen=True)
class SceneRules:
    """What every episode's scene holds, as ``MazeEnv`` explains."""

    apples: int = 0
    goal: bool = False
    blocked: tuple[str, ...] = ()
    goal_cells: tuple[Cell, ...] | None = None

    def check(self, layout: Layout) -> None:
        """Raise a ``ValueError`` if a maze has not the slots or cells for the rules."""
        layout.check_slots(self.blocked)
        free = _free_cells(layout)
        room = len(free) - 1 - self.goal
        if room < 0:
            rule = f"goal must be false in {layout.name}: its one cell is the start"
            raise ValueError(f"{rule}, got true")
        if not 0 <= self.apples <= room:
            raise ValueError(
                f"apples must be at least 0 and at most {room} in {layout.name} (one "
                f"cell each, beside start and goal), got {self.apples}"
            )
        cells = set(free if self.goal_cells is None else self.goal_cells)
        if not cells or not cells <= set(free):
            raise ValueError(
                f"goal_cells must be open cells of {layout.name}, slots left out, at "
                f"least one, got {min(cells - set(free), default='none')}"
            )


@dataclass
class Scene:
    """One episode's start, apples and goal in map units, and its closed slots.

    ``next_start`` draws a start for the rest of the episode, away from goal and slots.
    """

    start: Pose
    apples: tuple[tuple[float, float], ...]
    goal: tuple[float, float] | None
    goal_cell: Cell | None
    blocked: tuple[str, ...]
    next_start: Callable[[], Pose] = field(repr=False)


def draw_scene(
    layout: Layout,
    rules: SceneRules,
    generator: np.random.Generator,
    *,
    cell_size: float,
) -> Scene:
    r"""Draw one episode's scene: start, goal and apples in different cells, no slots.

    ``rules.check(layout)`` must have passed; the generator draws the whole episode.

    Examples:
        >>> layout = Layout("*****\n*   *\n*****", name="lane")
        >>> rules, generator = SceneRules(apples=1, goal=True), np.random.default_rng(0)
        >>> scene = draw_scene(layout, rules, generator, cell_size=10)
        >>> layout.cell_of(*scene.start[:2], 10) == scene.goal_cell
        False
    """

    def draw_place(cell: Cell) -> tuple[float, float]:
        x, y = layout.centre(cell, cell_size)
        dx, dy = generator.uniform(-_JITTER, _JITTER, size=2) * cell_size
        return x + float(dx), y + float(dy)

    def draw_pose(cells: Sequence[Cell]) -> Pose:
        x, y = draw_place(cells[int(generator.integers(len(cells)))])
        return Pose(x, y, float(generator.uniform(0.0, 360.0)))

    free = _free_cells(layout)
    order = [free[i] for i in generator.permutation(len(free))]
    goal_cell = None
    if rules.goal:
        # Start and apples come first, so that rules that allow every cell draw the
        # same scenes as rules without ``goal_cells``.
        others = 1 + rules.apples
        possible = free if rules.goal_cells is None else rules.goal_cells
        rotated = order[others:] + order[:others]
        goal_cell = next(cell for cell in rotated if cell in possible)
        order.remove(goal_cell)
    start_cell, *apple_cells = order[: 1 + rules.apples]
    return Scene(
        start=draw_pose([start_cell]),
        goal=None if goal_cell is None else draw_place(goal_cell),
        apples=tuple(draw_place(cell) for cell in apple_cells),
        goal_cell=goal_cell,
        blocked=layout.check_slots(rules.blocked),
        next_start=lambda: draw_pose([cell for cell in free if cell != goal_cell]),
    )


def _free_cells(layout: Layout) -> list[Cell]:
    slots = set(layout.slots.values())
    return [cell for cell in layout.cells if cell not in slots]
