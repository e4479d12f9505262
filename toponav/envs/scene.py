"""What one episode puts into a maze: start, apples, goal, closed slots.

Everything is drawn from one seeded generator, so that the scene of an episode is
a function of the seed and the episode's number alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from toponav.envs.layout import CELL_SIZE, Layout
from toponav.envs.layout_rules import Cell

# Starts, apples and goals stand up to this share of a cell off its centre.
_JITTER = 0.2


class Pose(NamedTuple):
    """A place and a direction.

    Args:
        x: east, in map units.
        y: north, in map units.
        heading: degrees counter-clockwise from east, in [0, 360).
    """

    x: float
    y: float
    heading: float


@dataclass(frozen=True)
class SceneRules:
    """What every episode's scene holds.

    Args:
        apples: number of apples (reward 1 each, gone when touched).
        goal: whether there is a goal (reward 10; it stays, and the agent is put
            at a new random start).
        blocked: letters of the slots that are closed from the start.

    Examples:
        >>> SceneRules(apples=2, goal=True, blocked=("a",)).num_reserved_cells
        4
    """

    apples: int = 0
    goal: bool = False
    blocked: tuple[str, ...] = ()

    @property
    def num_reserved_cells(self) -> int:
        """Cells that a scene needs: one each for start, goal and every apple."""
        return 1 + self.goal + self.apples

    def check(self, layout: Layout) -> None:
        """Check the rules against a maze.

        Raises:
            ValueError: if a slot is unknown or the slots cut the maze in two, or
                if the maze has too few cells for the apples and the goal.
        """
        if self.apples < 0:
            raise ValueError(f"apples must be at least 0, got {self.apples}")
        layout.check_slots(self.blocked)
        room = len(_spawn_cells(layout)) - 1 - self.goal
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


@dataclass
class Scene:
    """One episode's scene; ``next_start`` goes on drawing from its generator.

    Args:
        start: where the agent begins.
        apples: positions (x, y) of the apples, in map units.
        goal: position of the goal, or ``None``.
        goal_cell: its cell, or ``None``.
        blocked: letters of the slots that are closed from the start.
    """

    start: Pose
    apples: tuple[tuple[float, float], ...]
    goal: tuple[float, float] | None
    goal_cell: Cell | None
    blocked: tuple[str, ...]
    _cells: Sequence[Cell] = field(repr=False)
    _layout: Layout = field(repr=False)
    _generator: np.random.Generator = field(repr=False)

    def next_start(self) -> Pose:
        """A random start for the rest of the episode, away from goal and slots."""
        return _draw_pose(self._layout, self._cells, self._generator)


def draw_scene(
    layout: Layout, rules: SceneRules, generator: np.random.Generator
) -> Scene:
    r"""Draw one episode's scene.

    Start, goal and apples lie in different cells, none of them a slot.

    Args:
        layout: the maze.
        rules: what to put into it; ``rules.check(layout)`` must have passed.
        generator: gives all the randomness of the episode.

    Examples:
        >>> layout = Layout("*****\n*   *\n*****", name="lane")
        >>> scene = draw_scene(
        ...     layout, SceneRules(apples=1, goal=True), np.random.default_rng(0)
        ... )
        >>> len({layout.cell_of(*scene.start[:2]), scene.goal_cell})
        2
    """
    free = _spawn_cells(layout)
    order = generator.permutation(len(free))[: rules.num_reserved_cells]
    start_cell, *rest = (free[i] for i in order)
    goal_cell = rest.pop() if rules.goal else None
    start = _draw_pose(layout, [start_cell], generator)
    goal = None if goal_cell is None else _draw_place(layout, goal_cell, generator)
    apples = tuple(_draw_place(layout, cell, generator) for cell in rest)
    return Scene(
        start=start,
        apples=apples,
        goal=goal,
        goal_cell=goal_cell,
        blocked=layout.check_slots(rules.blocked),
        _cells=[cell for cell in free if cell != goal_cell],
        _layout=layout,
        _generator=generator,
    )


def _spawn_cells(layout: Layout) -> list[Cell]:
    slots = set(layout.slots.values())
    return [cell for cell in layout.cells if cell not in slots]


def _draw_place(
    layout: Layout, cell: Cell, generator: np.random.Generator
) -> tuple[float, float]:
    x, y = layout.centre(cell)
    dx, dy = generator.uniform(-_JITTER, _JITTER, size=2) * CELL_SIZE
    return x + float(dx), y + float(dy)


def _draw_pose(
    layout: Layout, cells: Sequence[Cell], generator: np.random.Generator
) -> Pose:
    cell = cells[int(generator.integers(len(cells)))]
    x, y = _draw_place(layout, cell, generator)
    return Pose(x, y, float(generator.uniform(0.0, 360.0)))
