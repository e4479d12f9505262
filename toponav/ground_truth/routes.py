"""Shortest paths from cell to cell through a layout whose slots may be closed."""

from collections.abc import Sequence

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path
from torch import Tensor

#: Distance to a cell that cannot be reached, in cells.
UNREACHABLE = 1 << 20

_STEPS = ((-1, 0), (1, 0), (0, -1), (0, 1))


def shortest_lengths(edges: Tensor, lengths: Tensor, num_nodes: int) -> Tensor:
    """Shortest paths between all N nodes by edges ``[E, 2]``, float64 ``[N, N]``."""
    entries = (np.asarray(lengths, np.float64), tuple(np.asarray(edges).T))
    graph = csr_array(entries, shape=(num_nodes, num_nodes))
    return torch.from_numpy(shortest_path(graph, directed=False))


class Routes:
    """Numbers of steps between all open cells, for every set of closed slots.

    Open cells are numbered row by row. A table of all pairs is computed when a set of
    closed slots is first asked for, so that one lookup serves a batch of agents in
    mazes with different ones. Arguments as in `GroundTruthDistances`.

    Examples:
        >>> mask = torch.tensor([[True, True, True], [True, False, True]])
        >>> routes = Routes(mask, slot_cells=[(0, 1)])
        >>> tables = routes.tables(torch.tensor([[False], [True]]))
        >>> routes.distances[tables, 0, 2]  # the slot open, then closed
        tensor([      2, 1048576])
    """

    def __init__(
        self, open_mask: Tensor, *, slot_cells: Sequence[tuple[int, int]] = ()
    ) -> None:
        open_mask = torch.as_tensor(open_mask)
        if open_mask.ndim != 2 or open_mask.dtype is not torch.bool:
            got = f"{open_mask.dtype} {tuple(open_mask.shape)}"
            raise ValueError(f"open_mask must be bool [rows, cols], got {got}")
        self.shape = (open_mask.shape[0], open_mask.shape[1])
        #: int64 ``[N, 2]``; row and column of each open cell.
        self.cells = open_mask.nonzero()
        #: int64 ``[rows, cols]``; number of each open cell, -1 in the wall.
        self.numbers = torch.full(self.shape, -1)
        self.numbers[open_mask] = torch.arange(len(self.cells))
        padded = torch.nn.functional.pad(self.numbers, (1, 1, 1, 1), value=-1)
        row, column = (self.cells + 1).unbind(1)
        #: int64 ``[N, 4]``; open cells to the north, south, west, east, -1 for wall.
        self.neighbours = torch.stack(
            [padded[row + down, column + right] for down, right in _STEPS], 1
        )
        slots = torch.tensor(slot_cells, dtype=torch.int64).reshape(-1, 2)
        self.slots = self.number(slots)
        if (self.slots < 0).any():
            raise ValueError(f"slot_cells must be open cells, got {slot_cells}")
        self._table_of: dict[tuple[bool, ...], int] = {}
        #: int64 ``[K, N, N]``; steps from cell to cell, ``UNREACHABLE`` if cut off.
        self.distances = torch.empty(0, len(self.cells), len(self.cells)).long()

    def number(self, cell: Tensor) -> Tensor:
        """The number of each ``cell``, int64 ``[*B, 2]`` to ``[*B]``."""
        return self.numbers[cell[..., 0], cell[..., 1]]

    def tables(self, blocked: Tensor) -> Tensor:
        """Which of ``distances`` hold for closed slots bool ``[B, S]``, ``[B]``."""
        if blocked.shape[-1] != len(self.slots):
            raise ValueError(
                f"blocked must have {len(self.slots)} slots, got {blocked.shape[-1]}"
            )
        rows = [tuple(row) for row in blocked.tolist()]
        for closed in dict.fromkeys(rows):
            if closed not in self._table_of:
                self._table_of[closed] = len(self.distances)
                new = self._all_pairs(torch.tensor(closed, dtype=torch.bool))
                self.distances = torch.cat([self.distances, new.unsqueeze(0)])
        return torch.tensor([self._table_of[row] for row in rows])

    def _all_pairs(self, closed: Tensor) -> Tensor:
        free = torch.ones(len(self.cells), dtype=torch.bool)
        free[self.slots[closed]] = False
        cell, side = (self.neighbours >= 0).nonzero().unbind(1)
        edges = torch.stack([cell, self.neighbours[cell, side]], 1)
        edges = edges[free[edges].all(1)]
        lengths = shortest_lengths(edges, torch.ones(len(edges)), len(free))
        lengths[~free] = torch.inf
        return lengths.clamp(max=UNREACHABLE).long()

    def first_steps(self, table: Tensor, here: Tensor) -> Tensor:
        """Steps to every cell after one to each neighbour, int64 ``[B, 4, N]``."""
        beside = self.neighbours[here]
        onward = self.distances[table.unsqueeze(1), beside]
        return onward.masked_fill((beside < 0).unsqueeze(-1), UNREACHABLE)

    def path(self, table: Tensor, here: Tensor, goal: Tensor, *, hops: int) -> Tensor:
        """Cells on shortest paths, ``[B, hops + 1]``; the last repeats at an end."""
        cells = [here]
        row = torch.arange(len(here))
        for _ in range(hops):
            onward = self.first_steps(table, cells[-1])[row, :, goal]
            steps, side = onward.min(1)
            beside = self.neighbours[cells[-1], side]
            stay = (cells[-1] == goal) | (steps >= UNREACHABLE)
            cells.append(torch.where(stay, cells[-1], beside))
        return torch.stack(cells, 1)
