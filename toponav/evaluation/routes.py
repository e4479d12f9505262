"""Shortest ways through a layout whose slots may be closed."""

from collections.abc import Sequence

import torch
from torch import Tensor

#: Distance to a cell that cannot be reached, in cells.
UNREACHABLE = 1 << 20

_STEPS = ((-1, 0), (1, 0), (0, -1), (0, 1))


class Routes:
    """Walking distances between all open cells, for every set of closed slots met.

    Open cells are numbered row by row. A table of all pairs is made the first
    time that a set of closed slots is asked for and then kept, so one lookup
    serves a batch of agents in mazes that differ in their closed slots.

    Args:
        open_mask: bool ``[rows, cols]``, true where the layout has floor; slots
            are floor.
        slot_cells: row and column of each slot.

    Raises:
        ValueError: if ``open_mask`` is not a bool matrix or a slot is no floor.

    Examples:
        >>> mask = torch.tensor([[True, True, True], [True, False, True]])
        >>> routes = Routes(mask, slot_cells=[(0, 1)])
        >>> tables = routes.tables(torch.tensor([[False], [True]]))
        >>> routes.distances[tables, 0, 2]  # the slot open, then closed
        tensor([      2, 1048576])

    Shape notation:
        B: batch of agents.  N: open cells.  S: slots.  K: tables.
    """

    #: int64 ``[N, 2]``; row and column of each open cell.
    cells: Tensor
    #: int64 ``[rows, cols]``; number of each open cell, -1 in the wall.
    numbers: Tensor
    #: int64 ``[N, 4]``; open cells to the north, south, west, east, -1 for wall.
    neighbours: Tensor
    #: int64 ``[K, N, N]``; steps from cell to cell, ``UNREACHABLE`` if cut off.
    distances: Tensor

    def __init__(
        self, open_mask: Tensor, *, slot_cells: Sequence[tuple[int, int]] = ()
    ) -> None:
        open_mask = torch.as_tensor(open_mask)
        if open_mask.ndim != 2 or open_mask.dtype is not torch.bool:
            raise ValueError(
                "open_mask must be bool [rows, cols], "
                f"got {open_mask.dtype} {tuple(open_mask.shape)}"
            )
        self.shape = (open_mask.shape[0], open_mask.shape[1])
        self.cells = open_mask.nonzero()
        self.numbers = torch.full(self.shape, -1)
        self.numbers[open_mask] = torch.arange(len(self.cells))
        padded = torch.nn.functional.pad(self.numbers, (1, 1, 1, 1), value=-1)
        row, column = (self.cells + 1).unbind(1)
        self.neighbours = torch.stack(
            [padded[row + down, column + right] for down, right in _STEPS], 1
        )
        slots = torch.tensor(slot_cells, dtype=torch.int64).reshape(-1, 2)
        self.slots = self.numbers[slots[:, 0], slots[:, 1]]
        if (self.slots < 0).any():
            raise ValueError(f"slot_cells must be open cells, got {slot_cells}")
        self._table_of: dict[tuple[bool, ...], int] = {}
        self.distances = torch.empty(0, len(self.cells), len(self.cells)).long()

    def number(self, cell: Tensor) -> Tensor:
        """Return the number of each ``cell``, int64 ``[*B, 2]`` to ``[*B]``."""
        return self.numbers[cell[..., 0], cell[..., 1]]

    def tables(self, blocked: Tensor) -> Tensor:
        """Return which table of ``distances`` holds for each agent.

        Args:
            blocked: bool ``[B, S]``, the closed slots.

        Returns:
            int64 ``[B]``.
        """
        if blocked.shape[-1] != len(self.slots):
            raise ValueError(
                f"blocked must have {len(self.slots)} slots, got {blocked.shape[-1]}"
            )
        if not len(self.slots):
            return torch.full(blocked.shape[:1], self._find_table(()))
        sets = [tuple(closed) for closed in blocked.tolist()]
        return torch.tensor([self._find_table(closed) for closed in sets])

    def _find_table(self, closed: tuple[bool, ...]) -> int:
        if closed not in self._table_of:
            self._table_of[closed] = len(self.distances)
            new = self._all_pairs(torch.tensor(closed, dtype=torch.bool))
            self.distances = torch.cat([self.distances, new.unsqueeze(0)])
        return self._table_of[closed]

    def _all_pairs(self, closed: Tensor) -> Tensor:
        """Breadth-first search from every cell at once, ``[N, N]``."""
        free = torch.ones(len(self.cells), dtype=torch.bool)
        free[self.slots[closed]] = False
        reached = torch.diag(free)
        distance = torch.where(reached, 0, UNREACHABLE)
        front, step = reached, 0
        while front.any():
            step += 1
            spread = torch.zeros_like(front)
            for neighbour in self.neighbours.unbind(1):
                spread |= front[:, neighbour] & (neighbour >= 0)
            front = spread & ~reached & free
            reached = reached | front
            distance[front] = step
        return distance

    def first_steps(self, table: Tensor, here: Tensor) -> Tensor:
        """Return how far every cell is by way of each neighbour of ``here``.

        Args:
            table: int64 ``[B]``, from :meth:`tables`.
            here: int64 ``[B]``, cell numbers.

        Returns:
            int64 ``[B, 4, N]``, steps after the first one; ``UNREACHABLE``
            through a wall.
        """
        beside = self.neighbours[here]
        onward = self.distances[table.unsqueeze(1), beside]
        return onward.masked_fill((beside < 0).unsqueeze(-1), UNREACHABLE)

    def path(self, table: Tensor, here: Tensor, goal: Tensor, *, hops: int) -> Tensor:
        """Return the next cells on a shortest way.

        Args:
            table: int64 ``[B]``, from :meth:`tables`.
            here: int64 ``[B]``, where the agents stand.
            goal: int64 ``[B]``, where they want to go.
            hops: how many cells to look ahead.

        Returns:
            int64 ``[B, hops + 1]``: ``here`` first; once at the goal, or with no
            way to it, the last cell repeats.
        """
        cells = [here]
        row = torch.arange(len(here))
        for _ in range(hops):
            onward = self.first_steps(table, cells[-1])[row, :, goal]
            steps, way = onward.min(1)
            beside = self.neighbours[cells[-1], way]
            stay = (cells[-1] == goal) | (steps >= UNREACHABLE)
            cells.append(torch.where(stay, cells[-1], beside))
        return torch.stack(cells, 1)
