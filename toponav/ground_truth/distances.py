"""How far apart points and poses of a maze are, whatever slots are closed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from toponav.ground_truth.routes import Routes, shortest_lengths, wrap_degrees
from toponav.worlds import Motion

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Up to here two poses are near: parallel corridors are two cells apart, and agents may
#: stand off their middles.
_NEAR_CELLS = 2.5
# Cells of distance that a degree off counts like: 90 degrees like 0.7 cells.
_CELLS_PER_DEGREE = 1 / 128


def cell_centres(cells: Tensor, num_rows: int, cell_size: float) -> Tensor:
    """Middles of cells (row from the north, column) in map units, ``[*B, 2]`` both."""
    row, column = cells.to(torch.float32).unbind(-1)
    return torch.stack([column + 0.5, num_rows - row - 0.5], -1) * cell_size


class GroundTruthDistances:
    """Walking distance between any two points of a maze's floor, walls respected.

    It is the straight line between points that see each other. Other paths lead through
    gates, the middles of the edges between neighbouring cells, and are a little longer
    than a rope around the corners. Points ``[*B, 2]`` are in map units; one that is not
    on the floor raises ``ValueError``. ``slot_cells`` are row and column of the slots,
    which ``open_mask`` counts as floor.

    Examples:
        >>> ring = torch.tensor([[1, 1, 1], [1, 0, 1], [1, 1, 1]]).bool()
        >>> distances = GroundTruthDistances(ring, cell_size=10, slot_cells=[(0, 1)])
        >>> corner, other = distances.centres([[0, 0], [0, 2]])
        >>> round(distances.distance(corner, other, closed=[True]).item(), 1)
        54.1
    """

    def __init__(
        self,
        open_mask: Tensor,
        *,
        cell_size: float,
        slot_cells: Sequence[tuple[int, int]] = (),
    ) -> None:
        self.routes = Routes(open_mask, slot_cells=slot_cells)
        self.open_mask = torch.as_tensor(open_mask)
        self.cell_size = cell_size
        self.slot_cells = list(slot_cells)
        self._gates_of, at = _find_gates(self.routes)
        middles = cell_centres(at, self.routes.shape[0], cell_size)
        # The last gate leads nowhere: it stands for walls, whose number is -1.
        self._gate_at = torch.cat([middles, torch.zeros(1, 2)])
        self._between: dict[tuple[int, ...], Tensor] = {}

    def centres(self, cells: ArrayLike) -> Floats:
        """Middles of cells in map units, int ``[*B, 2]`` to ``[*B, 2]``."""
        cell = torch.from_numpy(np.array(cells, np.int64))
        middles = cell_centres(cell, self.routes.shape[0], self.cell_size)
        return np.asarray(middles, np.float64)

    def distance(
        self, start: ArrayLike, end: ArrayLike, closed: ArrayLike | None = None
    ) -> Floats:
        """`geodesic` of arrays, twice ``[*B, 2]`` to float64 ``[*B]``."""
        one, other = (torch.from_numpy(np.array(at, np.float32)) for at in (start, end))
        return np.asarray(self.geodesic(one, other, closed), np.float64)

    def geodesic(
        self, start: Tensor, end: Tensor, closed: ArrayLike | None = None
    ) -> Tensor:
        """Distance ``[*B]``, infinite without a path past ``closed`` slots ``[S]``."""
        start, end = torch.broadcast_tensors(start, end)
        to_gate, first = self._to_gates(start, closed)
        from_gate, last = self._to_gates(end, closed)
        between = self._gate_distances(closed)
        between = between[first.unsqueeze(-1), last.unsqueeze(-2)]
        lengths = to_gate.unsqueeze(-1) + between + from_gate.unsqueeze(-2)
        around = lengths.flatten(-2).min(-1).values
        straight = (start - end).norm(dim=-1)
        return torch.where(self.visible(start, end, closed), straight, around)

    def cell_numbers(self, points: Tensor, closed: ArrayLike | None = None) -> Tensor:
        """Number of the open cell of each point, ``[*B, 2]`` to int64 ``[*B]``."""
        last = torch.tensor(self.routes.shape) - 1
        column, up = (points / self.cell_size).floor().long().unbind(-1)
        cell = torch.stack([last[0] - up, column], -1)
        inside = ((cell >= 0) & (cell <= last)).all(-1)
        number = self.routes.number(cell.clamp(min=0).minimum(last))
        on_floor = inside & (number >= 0) & ~torch.isin(number, self._shut(closed))
        if not on_floor.all():
            wrong = points[~on_floor][0].tolist()
            raise ValueError(f"points must lie on the maze's floor, got {wrong}.")
        return number

    def visible(
        self, start: Tensor, end: Tensor, closed: ArrayLike | None = None
    ) -> Tensor:
        """Whether the line stays on the floor: it changes its cell only at the grid."""
        mask = self.open_mask & ~torch.isin(self.routes.numbers, self._shut(closed))
        floor = mask.flip(0).T  # [x, y] in cells
        clear = torch.ones(start.shape[:-1], dtype=torch.bool)
        for axis, plane in enumerate((floor, floor.T)):
            line = torch.arange(1, len(plane))
            at = line * self.cell_size
            here, there = start[..., axis, None], end[..., axis, None]
            crossed = (here - at) * (there - at) < 0
            share = ((at - here) / (there - here)).masked_fill(~crossed, 0)
            side = 1 - axis
            across = torch.lerp(start[..., side, None], end[..., side, None], share)
            index = (across / self.cell_size).floor().long()
            index = index.clamp(0, plane.shape[1] - 1)
            free = plane[line - 1, index] & plane[line, index]
            clear &= (free | ~crossed).all(-1)
        return clear

    def _shut(self, closed: ArrayLike | None) -> Tensor:
        """Numbers of the cells whose slots are closed."""
        if closed is None:
            return self.routes.slots[:0]
        return self.routes.slots[torch.from_numpy(np.array(closed, bool))]

    def _to_gates(
        self, points: Tensor, closed: ArrayLike | None
    ) -> tuple[Tensor, Tensor]:
        gates = self._gates_of[self.cell_numbers(points, closed)]
        distance = (points.unsqueeze(-2) - self._gate_at[gates]).norm(dim=-1)
        return distance.masked_fill(gates < 0, torch.inf), gates

    def _gate_distances(self, closed: ArrayLike | None) -> Tensor:
        shut = self._shut(closed)
        key = tuple(shut.tolist())
        if key not in self._between:
            gates = self._gates_of.clone()
            gates[shut] = -1
            # All gates of a cell can walk to each other straight.
            both = gates.unsqueeze(2).expand(-1, 4, 4)
            pairs = torch.stack([both, both.transpose(1, 2)], -1).flatten(0, 2)
            pairs = pairs[(pairs >= 0).all(1)]
            start, end = self._gate_at[pairs].unbind(1)
            lengths = (start - end).norm(dim=-1)
            between = shortest_lengths(pairs, lengths, len(self._gate_at))
            self._between[key] = between.float()
        return self._between[key]


def _find_gates(routes: Routes) -> tuple[Tensor, Tensor]:
    """Numbers of each cell's gates, -1 for walls, and where they are, in cells."""
    neighbours = routes.neighbours
    cell, side = (neighbours >= 0).nonzero().unbind(1)
    pair = torch.stack([cell, neighbours[cell, side]], 1).sort(1).values
    ends, gate = pair.unique(dim=0, return_inverse=True)
    gates_of = torch.full_like(neighbours, -1)
    gates_of[cell, side] = gate
    return gates_of, routes.cells[ends].float().mean(1).reshape(-1, 2)


@dataclass(frozen=True)
class PairTruth:
    """The truth about P pairs of poses; every tensor is ``[P]``."""

    distance: Tensor  # on foot, in map units
    straight: Tensor  # in map units
    heading_difference: Tensor  # degrees in [0, 180]
    decisions: Tensor  # steps and turns one after the other
    least_decisions: Tensor  # the larger of both: one action may do both
    through_wall: Tensor  # near in the plan, at least twice as far on foot


def pair_truth(
    distances: GroundTruthDistances,
    positions: tuple[Tensor, Tensor],
    headings: tuple[Tensor, Tensor],
    *,
    motion: Motion,
) -> PairTruth:
    """Measure pairs of poses, ``[P, 2]`` in map units and ``[P]`` in degrees.

    Examples:
        >>> distances = GroundTruthDistances(torch.ones(1, 4).bool(), cell_size=10)
        >>> positions = torch.tensor([[[5.0, 5.0]], [[10.0, 5.0]]])
        >>> from toponav.worlds import Effect
        >>> motion = Motion(cell_size=10, effects=(Effect(ahead=2.5), Effect(turn=20)))
        >>> headings = torch.tensor([[350.0], [30.0]])
        >>> pair_truth(distances, positions, headings, motion=motion).decisions
        tensor([4.])
    """
    anchor, other = positions
    if anchor.shape != other.shape or anchor.shape[-1:] != (2,):
        shapes = f"{tuple(anchor.shape)} and {tuple(other.shape)}"
        raise ValueError(f"positions must be two of [P, 2], got {shapes}.")
    difference = wrap_degrees(headings[0].reshape(-1) - headings[1].reshape(-1)).abs()
    distance = distances.geodesic(anchor, other)
    straight = (anchor - other).norm(dim=-1)
    near = _NEAR_CELLS * distances.cell_size
    steps, turns = distance / motion.step, difference / motion.turn
    return PairTruth(
        distance=distance,
        straight=straight,
        heading_difference=difference,
        decisions=steps + turns,
        least_decisions=torch.maximum(steps, turns),
        through_wall=(straight <= near) & (distance >= 2 * near),
    )


def pick_goal_views(
    positions: ArrayLike,
    headings: ArrayLike,
    cells: ArrayLike,
    distances: GroundTruthDistances,
    *,
    num_views: int = 4,
    reach: float = 0.75,
) -> Ints:
    """The pictures of K places in V directions from east on, int ``[K, V]``, or -1.

    Of all pictures, taken at ``positions`` ``[P, 2]`` in map units with ``headings``
    ``[P]`` in degrees, those up to ``reach`` cells on foot from the middle of a place,
    one of ``cells`` ``[K, 2]``, are ranked by both distance and direction.

    Examples:
        >>> distances = GroundTruthDistances(torch.ones(1, 3).bool(), cell_size=10)
        >>> taken, looking = [[5.0, 5.0], [6.0, 5.0], [15.0, 5.0]], [0.0, 180, 90]
        >>> pick_goal_views(taken, looking, [[0, 0]], distances, num_views=2)
        array([[0, 1]])
    """
    taken, looking = np.asarray(positions, float), np.asarray(headings, float)
    wanted = np.arange(num_views) * 360 / num_views
    off = np.abs((looking[:, None] - wanted + 180) % 360 - 180)
    chosen = []
    for middle in distances.centres(cells):
        away = distances.distance(taken, np.broadcast_to(middle, taken.shape))
        cost = away[:, None] + off * _CELLS_PER_DEGREE * distances.cell_size
        cost[away > reach * distances.cell_size] = np.inf
        best = cost.argmin(0)
        chosen.append(np.where(np.isfinite(cost.min(0)), best, -1))
    return np.stack(chosen)
