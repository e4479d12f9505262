"""Shortest paths through a layout whose slots may be closed, and how to follow them."""

from collections.abc import Sequence

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path
from torch import Tensor

from toponav.worlds import Motion, WorldSpec

#: Distance to a cell that cannot be reached, in cells.
UNREACHABLE = 1 << 20

_STEPS = ((-1, 0), (1, 0), (0, -1), (0, 1))
#: Cells along the path at which an agent aims; above 1.4 the line to that point may
#: cross a wall.
_LOOKAHEAD = 1.25
#: Degrees up to which it moves while it turns.
_WIDEST = 60.0


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
        if (given := blocked.shape[-1]) != len(self.slots):
            raise ValueError(f"blocked must have {len(self.slots)} slots, got {given}")
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


def require_motion(world: WorldSpec) -> Motion:
    """The motion of a world, refused if it has no ground truth."""
    if world.motion is None:
        raise ValueError("world must report poses, got one without ground truth")
    return world.motion


def wrap_degrees(angle: Tensor) -> Tensor:
    """``angle`` in [-180, 180)."""
    return (angle + 180) % 360 - 180


def bearing(start: Tensor, end: Tensor) -> Tensor:
    """Direction from ``start`` to ``end`` in degrees, 0 east, 90 north."""
    x, y = (end - start).unbind(-1)
    return torch.rad2deg(torch.atan2(y, x))


def point_ahead(
    path: Tensor, position: Tensor, *, cell_size: float, lookahead: float
) -> Tensor:
    """The point of ``path`` that lies ``lookahead`` in front of the agent, ``[B, 2]``.

    Aiming at it rounds corners instead of stopping in them (pure pursuit). ``position``
    is in the first cell of the path ``[B, P, 2]``, which may end with repeated points.
    """
    legs = path[:, 1:] - path[:, :-1]
    covered = ((position - path[:, 0]) * legs[:, 0]).sum(-1) / cell_size
    arc = ((covered + lookahead) / cell_size).clamp(0, legs.shape[1])
    leg = arc.floor().clamp(max=legs.shape[1] - 1).long()
    row = torch.arange(len(path), device=path.device)
    return path[row, leg] + (arc - leg).unsqueeze(-1) * legs[row, leg]


class Steering:
    """Chooses the actions that follow a path in a world, cutting its corners.

    The world must report poses, and its actions go ahead and turn to both sides;
    one that turns on the spot and one that turns on the way stand in for each other.

    Examples:
        >>> from toponav.worlds import Effect
        >>> effects = Effect(ahead=2.5), Effect(turn=20), Effect(turn=-20)
        >>> motion = Motion(cell_size=10, effects=effects)
        >>> world = WorldSpec(view_size=(1, 1), actions=(*"alr",), motion=motion)
        >>> Steering(world).towards(torch.tensor([3.0, 30.0, -30.0, 120.0]))
        tensor([0, 1, 2, 1])
    """

    def __init__(self, world: WorldSpec) -> None:
        self.motion = require_motion(world)
        # By whether it goes ahead or stays, and turns right (-1), not, or left (1).
        first: dict[tuple[bool, int], int] = {}
        # What goes straight on comes before what goes aslant.
        effects = sorted(
            enumerate(self.motion.effects), key=lambda one: abs(one[1].left)
        )
        for number, (ahead, left, turn) in effects:
            if ahead > 0 or ahead == left == 0:
                first.setdefault((ahead > 0, (turn > 0) - (turn < 0)), number)
        if (True, 0) not in first or {side for _, side in first} != {-1, 0, 1}:
            got = ", ".join(world.actions)
            rule = "world must have actions that go ahead and turn to both sides"
            raise ValueError(f"{rule}, got {got}")
        self.ahead = first[True, 0]
        first = {(not on, side): it for (on, side), it in first.items()} | first
        # Row: on the spot or on the way; column: to the right or to the left.
        order = [[first[on, side] for side in (-1, 1)] for on in (False, True)]
        self.turns = torch.tensor(order)

    def __call__(self, path: Tensor, position: Tensor, heading: Tensor) -> Tensor:
        """The actions ``[B]`` that follow paths of cell centres, the own cell first."""
        size = self.motion.cell_size
        aim = point_ahead(path, position, cell_size=size, lookahead=_LOOKAHEAD * size)
        return self.towards(wrap_degrees(bearing(position, aim) - heading))

    def towards(self, off: Tensor) -> Tensor:
        """The actions that turn left by ``off`` degrees, int64 ``[B]``."""
        action = self.turns[(off.abs() <= _WIDEST).long(), (off > 0).long()]
        return action.masked_fill(off.abs() <= self.motion.turn / 2, self.ahead)
