"""How well an agent gets to its goals: pure functions of a trace and the maze.

- `goals_reached`, `first_goal`, `success_within`: how often and how soon.
- `TrueWays`: true distances, whatever slots are closed.
- `measure_legs`, `success_weighted_by_length`, `mean_detour`: how straight.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from toponav.evaluation.navigation_trace import (
    Bools,
    Floats,
    Ints,
    Leg,
    NavigationTrace,
    find_legs,
)
from toponav.evaluation.pair_truth import MazeMetric
from toponav.evaluation.steering import cell_centres


def goals_reached(trace: NavigationTrace) -> Ints:
    """How often each episode reached its goal, ``[N]``."""
    count: Ints = trace.reached.sum(1).astype(np.int64)
    return count


def first_goal(trace: NavigationTrace) -> Ints:
    """Decisions that each episode took to its first goal, ``[N]``; -1 without one."""
    at = trace.reached.argmax(1) + 1
    return np.where(trace.reached.any(1), at, -1)


def success_within(first: ArrayLike, times: ArrayLike) -> Floats:
    """Share of the episodes that reached their goal in time, as in the paper's Fig. 20.

    Args:
        first: int ``[N]``, decisions to the first goal, -1 without one.
        times: ``[K]``, decisions.

    Returns:
        ``[K]``, in [0, 1].

    Examples:
        >>> success_within([10, -1, 300, 40], [9, 10, 50, 5000]).tolist()
        [0.0, 0.25, 0.5, 0.75]
    """
    decisions, limits = np.asarray(first), np.asarray(times)
    in_time = (decisions[:, None] >= 0) & (decisions[:, None] <= limits)
    share: Floats = in_time.mean(0)
    return share


class TrueWays:
    """True walking distances in a maze, for any set of closed slots.

    Args:
        open_mask: bool ``[rows, cols]``, true where the layout has floor; slots are
            floor.
        slot_cells: row and column of each slot.
        cell_size: side of a cell in map units.

    Examples:
        >>> ring = torch.tensor([[1, 1, 1], [1, 0, 1], [1, 1, 1]]).bool()
        >>> ways = TrueWays(ring, slot_cells=[(0, 1)])
        >>> corner, other = ways.centres([[0, 0], [0, 2]])
        >>> ways.distance(corner, other, np.array([False])).item()
        256.0
        >>> round(ways.distance(corner, other, np.array([True])).item())
        693

    Shape notation:
        B: any batch dimensions.  S: slots.
    """

    def __init__(
        self,
        open_mask: Tensor,
        *,
        slot_cells: Sequence[tuple[int, int]] = (),
        cell_size: float = 128.0,
    ) -> None:
        self.open_mask = torch.as_tensor(open_mask)
        self.slot_cells = list(slot_cells)
        self.cell_size = cell_size
        self._metrics: dict[tuple[bool, ...], MazeMetric] = {}

    def centres(self, cells: ArrayLike) -> Floats:
        """Middles of cells in map units, int ``[*B, 2]`` to ``[*B, 2]``."""
        rows = self.open_mask.shape[0]
        cell = torch.from_numpy(np.array(cells, np.int64))
        return np.asarray(cell_centres(cell, rows, self.cell_size), np.float64)

    def metric(self, closed: ArrayLike) -> MazeMetric:
        """Distances with some slots closed, bool ``[S]``."""
        key = tuple(bool(one) for one in np.asarray(closed))
        if key not in self._metrics:
            mask = self.open_mask.clone()
            for (row, column), is_closed in zip(self.slot_cells, key, strict=True):
                mask[row, column] &= not is_closed
            self._metrics[key] = MazeMetric(mask, cell_size=self.cell_size)
        return self._metrics[key]

    def distance(
        self, start: ArrayLike, end: ArrayLike, closed: ArrayLike | None = None
    ) -> Floats:
        """Walking distance in map units, twice ``[*B, 2]`` to ``[*B]``.

        Args:
            start: positions in map units, on the floor.
            end: positions in map units, on the floor.
            closed: bool ``[S]``; none by default.
        """
        shut = np.zeros(len(self.slot_cells), bool) if closed is None else closed
        first, last = (
            torch.from_numpy(np.array(points, np.float32)) for points in (start, end)
        )
        return np.asarray(self.metric(shut).geodesic(first, last), np.float64)


@dataclass(frozen=True)
class LegMeasures:
    """The legs of a trace, and how long they were and might have been.

    Args:
        legs: the legs.
        walked: ``[L]``, the way that was walked, in map units; the last decision of a
            leg ends elsewhere and counts as the straight way to the middle of the
            goal's cell.
        optimum: ``[L]``, the shortest way from the start to the middle of the goal's
            cell, around the slots that were closed at the start.
    """

    legs: list[Leg]
    walked: Floats
    optimum: Floats

    @property
    def reached(self) -> Bools:
        """Whether each leg ended at the goal, ``[L]``."""
        return np.array([leg.reached for leg in self.legs], bool)

    @property
    def is_first(self) -> Bools:
        """Whether each leg begins its episode, ``[L]``."""
        return np.array([leg.start == 0 for leg in self.legs], bool)


def measure_legs(trace: NavigationTrace, ways: TrueWays) -> LegMeasures:
    """Walked and shortest lengths of all legs."""
    legs = find_legs(trace)
    steps = np.linalg.norm(np.diff(trace.positions, axis=1), axis=2)
    walked, optimum = [], []
    for leg in legs:
        at, last = (leg.episode, leg.start), (leg.episode, leg.end - 1)
        goal = ways.centres(trace.goal_cells[at])
        length = steps[leg.episode, leg.start : leg.end - 1].sum()
        if leg.reached:
            length += np.linalg.norm(trace.positions[last] - goal)
        walked.append(float(length))
        optimum.append(ways.distance(trace.positions[at], goal, trace.blocked[at]))
    return LegMeasures(legs, np.array(walked), np.array(optimum))


def success_weighted_by_length(measures: LegMeasures) -> Floats:
    """SPL of each episode's first leg, ``[N]``: optimum / max(walked, optimum), or 0.

    Only first legs count: each has the whole episode to end in, while of the others
    those are cut off that take long.

    Reference:
        Anderson et al., "On evaluation of embodied navigation agents" (2018).
        https://arxiv.org/abs/1807.06757
    """
    first = measures.is_first
    walked, optimum = measures.walked[first], measures.optimum[first]
    longest = np.maximum(np.maximum(walked, optimum), 1e-9)
    spl: Floats = measures.reached[first] * optimum / longest
    return spl


def mean_detour(measures: LegMeasures, *, shortest: float = 128.0) -> float:
    """Mean of walked / optimum over the legs that reached their goal.

    Args:
        measures: of the legs.
        shortest: legs with a shorter optimum in map units are left out: their ratio
            says little.

    Returns:
        NaN without such a leg.
    """
    counted = measures.reached & (measures.optimum >= shortest)
    if not counted.any():
        return float("nan")
    return float((measures.walked[counted] / measures.optimum[counted]).mean())
