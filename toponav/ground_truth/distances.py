"""`GroundTruthDistances`: walking distances in a maze, whatever slots are closed."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from toponav.ground_truth.routes import Routes, shortest_lengths

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def cell_centres(cells: Tensor, num_rows: int, cell_size: float) -> Tensor:
    """Middles of cells (row from the north, column) in map units, ``[*B, 2]`` both."""
    row, column = cells.to(torch.float32).unbind(-1)
    return torch.stack([column + 0.5, num_rows - row - 0.5], -1) * cell_size


class GroundTruthDistances:
    """Walking distance between any two points of a maze's floor, walls respected.

    Points that see each other are as far apart as the straight line. Otherwise the path
    leads through gates, the middles of the edges between neighbouring cells, which is
    at most a little longer than a rope around the corners. Points ``[*B, 2]`` are in
    map units; one that does not lie on the floor raises ``ValueError``. ``slot_cells``
    are row and column of the slots, which ``open_mask`` counts as floor.

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
        self._between: dict[tuple[bool, ...], Tensor] = {}

    def centres(self, cells: ArrayLike) -> Floats:
        """Middles of cells in map units, int ``[*B, 2]`` to ``[*B, 2]``."""
        cell = torch.from_numpy(np.array(cells, np.int64))
        middles = cell_centres(cell, self.routes.shape[0], self.cell_size)
        return np.asarray(middles, np.float64)

    def distance(
        self, start: ArrayLike, end: ArrayLike, closed: ArrayLike | None = None
    ) -> Floats:
        """`geodesic` of arrays, twice ``[*B, 2]`` to float64 ``[*B]``."""
        first, last = (
            torch.from_numpy(np.array(points, np.float32)) for points in (start, end)
        )
        return np.asarray(self.geodesic(first, last, closed), np.float64)

    def geodesic(
        self, start: Tensor, end: Tensor, closed: ArrayLike | None = None
    ) -> Tensor:
        """Distance ``[*B]``, infinite without a path past ``closed`` slots ``[S]``."""
        key = self._slots_closed(closed)
        start, end = torch.broadcast_tensors(start, end)
        to_gate, first = self._to_gates(start, key)
        from_gate, last = self._to_gates(end, key)
        between = self._gate_distances(key)[first.unsqueeze(-1), last.unsqueeze(-2)]
        lengths = to_gate.unsqueeze(-1) + between + from_gate.unsqueeze(-2)
        around = lengths.flatten(-2).min(-1).values
        straight = (start - end).norm(dim=-1)
        return torch.where(self.visible(start, end, key), straight, around)

    def cell_numbers(self, points: Tensor) -> Tensor:
        """Number of the open cell of each point, ``[*B, 2]`` to int64 ``[*B]``."""
        rows, columns = self.routes.shape
        x, y = (points / self.cell_size).floor().long().unbind(-1)
        row = rows - 1 - y
        inside = (row >= 0) & (row < rows) & (x >= 0) & (x < columns)
        cell = torch.stack([row.clamp(0, rows - 1), x.clamp(0, columns - 1)], -1)
        number = self.routes.number(cell).masked_fill(~inside, -1)
        self._require_floor(points, number >= 0)
        return number

    def visible(
        self, start: Tensor, end: Tensor, closed: ArrayLike | None = None
    ) -> Tensor:
        """Whether the line stays on the floor: it changes its cell only at the grid."""
        mask = self.open_mask.clone()
        slots = zip(self.slot_cells, self._slots_closed(closed), strict=True)
        for (row, column), is_closed in slots:
            mask[row, column] &= not is_closed
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

    def _slots_closed(self, closed: ArrayLike | None) -> tuple[bool, ...]:
        if closed is None:
            return (False,) * len(self.slot_cells)
        return tuple(bool(one) for one in np.asarray(closed))

    def _require_floor(self, points: Tensor, on_floor: Tensor) -> None:
        if not on_floor.all():
            wrong = points[~on_floor][0].tolist()
            raise ValueError(f"points must lie on the maze's floor, got {wrong}.")

    def _to_gates(
        self, points: Tensor, closed: tuple[bool, ...]
    ) -> tuple[Tensor, Tensor]:
        cells = self.cell_numbers(points)
        shut = self.routes.slots[torch.tensor(closed, dtype=torch.bool)]
        self._require_floor(points, ~torch.isin(cells, shut))
        gates = self._gates_of[cells]
        distance = (points.unsqueeze(-2) - self._gate_at[gates]).norm(dim=-1)
        return distance.masked_fill(gates < 0, torch.inf), gates

    def _gate_distances(self, closed: tuple[bool, ...]) -> Tensor:
        if closed not in self._between:
            gates = self._gates_of.clone()
            gates[self.routes.slots[torch.tensor(closed, dtype=torch.bool)]] = -1
            # All gates of a cell can walk to each other straight.
            both = gates.unsqueeze(2).expand(-1, 4, 4)
            pairs = torch.stack([both, both.transpose(1, 2)], -1).flatten(0, 2)
            pairs = pairs[(pairs >= 0).all(1)]
            start, end = self._gate_at[pairs].unbind(1)
            lengths = (start - end).norm(dim=-1)
            between = shortest_lengths(pairs, lengths, len(self._gate_at))
            self._between[closed] = between.float()
        return self._between[closed]


def _find_gates(routes: Routes) -> tuple[Tensor, Tensor]:
    neighbours = routes.neighbours
    cell, side = (neighbours >= 0).nonzero().unbind(1)
    other = neighbours[cell, side]
    pair = torch.stack([torch.minimum(cell, other), torch.maximum(cell, other)], 1)
    ends, gate = pair.unique(dim=0, return_inverse=True)
    gates_of = torch.full_like(neighbours, -1)
    gates_of[cell, side] = gate
    return gates_of, routes.cells[ends].float().mean(1).reshape(-1, 2)
