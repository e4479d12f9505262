"""What one episode puts into a maze: start, apples, goal, closed slots."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from toponav.envs.layout import Layout
from toponav.envs.layout_rules import Cell

# Starts, apples and goals stand up to this share of a cell off its centre.
_JITTER = 0.2


class Pose(NamedTuple):
    """A position (x east, y north, in map units) and a direction.

    ``heading`` is in degrees counter-clockwise from east, in [0, 360).
    """

    x: float
    y: float
    heading: float


@dataclass(frozen=True)
class SceneRules:
    """What every episode's scene holds.

    Args:
        apples: number of apples; each gives its reward once.
        goal: whether there is a goal; it stays, and puts the agent at a new start.
        blocked: letters of the slots that are closed from the start.
        goal_cells: cells where the goal can be; all but the slots unless given.
    """

    apples: int = 0
    goal: bool = False
    blocked: tuple[str, ...] = ()
    goal_cells: tuple[Cell, ...] | None = None

    def check(self, layout: Layout) -> None:
        """Raise a ``ValueError`` if a maze has not the slots or cells for the rules."""
        if self.apples < 0:
            raise ValueError(f"apples must be at least 0, got {self.apples}")
        layout.check_slots(self.blocked)
        free = _free_cells(layout)
        room = len(free) - 1 - self.goal
        if room < 0:
            raise ValueError(
                f"goal must be false in {layout.name}: it has one cell, which is "
                "the start, got true"
            )
        if self.apples > room:
            raise ValueError(
                f"apples must be at most {room} in {layout.name} (one cell each, "
                f"beside start and goal), got {self.apples}"
            )
        if self.goal_cells is not None:
            strange = set(self.goal_cells) - set(free)
            if strange or not self.goal_cells:
                raise ValueError(
                    f"goal_cells must be open cells of {layout.name}, slots left out, "
                    f"at least one, got {min(strange, default='none')}"
                )


@dataclass
class Scene:
    """One episode's scene, in map units.

    Args:
        start: where the agent begins.
        apples: positions (x, y) of the apples.
        goal: position of the goal, or ``None``.
        goal_cell: its cell, or ``None``.
        blocked: letters of the slots that are closed from the start.
    """

    start: Pose
    apples: tuple[tuple[float, float], ...]
    goal: tuple[float, float] | None
    goal_cell: Cell | None
    blocked: tuple[str, ...]
    _draw_pose: Callable[[Sequence[Cell]], Pose] = field(repr=False)
    _start_cells: Sequence[Cell] = field(repr=False)

    def next_start(self) -> Pose:
        """A random start for the rest of the episode, away from goal and slots."""
        return self._draw_pose(self._start_cells)


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
    goal_cell = _pop_goal_cell(order, rules) if rules.goal else None
    start_cell, *apple_cells = order[: 1 + rules.apples]
    return Scene(
        start=draw_pose([start_cell]),
        goal=None if goal_cell is None else draw_place(goal_cell),
        apples=tuple(draw_place(cell) for cell in apple_cells),
        goal_cell=goal_cell,
        blocked=layout.check_slots(rules.blocked),
        _draw_pose=draw_pose,
        _start_cells=[cell for cell in free if cell != goal_cell],
    )


def _pop_goal_cell(order: list[Cell], rules: SceneRules) -> Cell:
    """Take the goal's cell out of the cells in their drawn order."""
    # Start and apples come first, so that rules that allow every cell draw the same
    # scenes as rules without ``goal_cells``.
    others = 1 + rules.apples
    possible = order if rules.goal_cells is None else rules.goal_cells
    goal = next(cell for cell in order[others:] + order[:others] if cell in possible)
    order.remove(goal)
    return goal


def _free_cells(layout: Layout) -> list[Cell]:
    slots = set(layout.slots.values())
    return [cell for cell in layout.cells if cell not in slots]
