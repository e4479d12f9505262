"""What is true of two poses in a maze: how far apart they are for a walker.

- `MazeMetric`: distances through the maze between any two points of its floor.
- `PairTruth`, `pair_truth`: all that a report wants to know of pairs of poses.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from toponav.evaluation.routes import Routes
from toponav.evaluation.steering import Motion, wrap_degrees


class MazeMetric:
    """Walking distance between two points of a maze, walls respected.

    Points that see each other are as far apart as the straight line. Otherwise the
    way leads through the middles of the edges between neighbouring cells; the
    shortest such way is at most a little longer than a rope around the corners,
    which no walker with a body can follow either.

    Args:
        open_mask: bool ``[rows, cols]``, true where there is floor; set closed slots
            to false.
        cell_size: side of a cell in map units.

    Raises:
        ValueError: if ``open_mask`` is no bool matrix; from the methods, if a point
            does not lie on the floor.

    Examples:
        >>> metric = MazeMetric(torch.tensor([[True, True], [True, False]]))
        >>> corner = metric.geodesic(
        ...     torch.tensor([192.0, 192.0]), torch.tensor([64.0, 64.0])
        ... )
        >>> round(float(corner), 1)  # 64 + 64 * sqrt(2) + 64
        218.5

    Shape notation:
        B: any batch dimensions.  G: gates, the edges between open cells.
    """

    def __init__(self, open_mask: Tensor, *, cell_size: float = 128.0) -> None:
        self.routes = Routes(open_mask)
        self.cell_size = cell_size
        self.open_mask = torch.as_tensor(open_mask)
        rows, _ = self.routes.shape
        self._gates_of, at = _find_gates(self.routes)
        row, column = at.unbind(-1)
        middles = torch.stack([column + 0.5, rows - row - 0.5], -1) * cell_size
        # The last gate leads nowhere: it stands for walls, whose number is -1.
        self._gate_at = torch.cat([middles, torch.zeros(1, 2)])
        self._between = self._all_gate_distances()

    def _all_gate_distances(self) -> Tensor:
        """Floyd and Warshall's shortest ways between all gates, ``[G, G]``."""
        num = len(self._gate_at)
        between = torch.full((num, num), torch.inf)
        # All gates of a cell can walk to each other straight.
        both = self._gates_of.unsqueeze(2).expand(-1, 4, 4)
        fits = (both >= 0) & (both.transpose(1, 2) >= 0)
        start, end = both[fits], both.transpose(1, 2)[fits]
        between[start, end] = (self._gate_at[start] - self._gate_at[end]).norm(dim=-1)
        for way in range(num):
            via = between[:, way].unsqueeze(1) + between[way].unsqueeze(0)
            between = torch.minimum(between, via)
        return between

    def cell_numbers(self, points: Tensor) -> Tensor:
        """Which open cell each point lies in, ``[*B, 2]`` to int64 ``[*B]``."""
        rows, columns = self.routes.shape
        x, y = (points / self.cell_size).floor().long().unbind(-1)
        row = rows - 1 - y
        inside = (row >= 0) & (row < rows) & (x >= 0) & (x < columns)
        cell = torch.stack([row.clamp(0, rows - 1), x.clamp(0, columns - 1)], -1)
        number = self.routes.number(cell).masked_fill(~inside, -1)
        if (number < 0).any():
            wrong = points[number < 0][0].tolist()
            raise ValueError(f"points must lie on the maze's floor, got {wrong}.")
        return number

    def visible(self, start: Tensor, end: Tensor) -> Tensor:
        """Whether the straight line stays on the floor, twice ``[*B, 2]`` to ``[*B]``.

        Exact: the line changes its cell only where it crosses the grid.
        """
        clear = torch.ones(start.shape[:-1], dtype=torch.bool)
        rows, columns = self.routes.shape
        for axis, num_lines in ((0, columns), (1, rows)):
            lines = torch.arange(1, num_lines, device=start.device) * self.cell_size
            here, there = start[..., axis, None], end[..., axis, None]
            crossed = (here - lines) * (there - lines) < 0
            share = ((lines - here) / (there - here)).masked_fill(~crossed, 0)
            other = 1 - axis
            across = torch.lerp(start[..., other, None], end[..., other, None], share)
            index = (across / self.cell_size).floor().long()
            index = index.clamp(0, (rows if axis == 0 else columns) - 1)
            line = torch.arange(1, num_lines, device=start.device).expand_as(index)
            if axis == 0:
                row = rows - 1 - index
                free = self.open_mask[row, line - 1] & self.open_mask[row, line]
            else:
                free = (
                    self.open_mask[rows - line, index]
                    & self.open_mask[rows - 1 - line, index]
                )
            clear &= (free | ~crossed).all(-1)
        return clear

    def geodesic(self, start: Tensor, end: Tensor) -> Tensor:
        """Walking distance in map units, twice ``[*B, 2]`` to ``[*B]``.

        Infinite if there is no way.
        """
        start, end = torch.broadcast_tensors(start, end)
        to_gate, first = self._to_gates(start)
        from_gate, last = self._to_gates(end)
        middle = self._between[first.unsqueeze(-1), last.unsqueeze(-2)]
        ways = to_gate.unsqueeze(-1) + middle + from_gate.unsqueeze(-2)
        around = ways.flatten(-2).min(-1).values
        straight = (start - end).norm(dim=-1)
        return torch.where(self.visible(start, end), straight, around)

    def _to_gates(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Distances to the gates of a point's cell and their numbers, ``[*B, 4]``."""
        gates = self._gates_of[self.cell_numbers(points)]
        distance = (points.unsqueeze(-2) - self._gate_at[gates]).norm(dim=-1)
        return distance.masked_fill(gates < 0, torch.inf), gates


def _find_gates(routes: Routes) -> tuple[Tensor, Tensor]:
    """Number the edges between open cells.

    Returns:
        int64 ``[N, 4]``, the gates of each cell to its neighbours, -1 for wall; and
        float ``[G, 2]``, row and column of each gate's middle.
    """
    neighbours = routes.neighbours
    cell, side = (neighbours >= 0).nonzero().unbind(1)
    other = neighbours[cell, side]
    pair = torch.stack([torch.minimum(cell, other), torch.maximum(cell, other)], 1)
    ends, gate = pair.unique(dim=0, return_inverse=True)
    gates_of = torch.full_like(neighbours, -1)
    gates_of[cell, side] = gate
    return gates_of, routes.cells[ends].float().mean(1).reshape(-1, 2)


@dataclass(frozen=True)
class PairTruth:
    """The truth about pairs of poses; every tensor is ``[P]``.

    Args:
        distance: walking distance in map units, see `MazeMetric.geodesic`.
        straight: straight distance in map units.
        heading_difference: degrees in [0, 180].
        decisions: decisions of a perfect walker that turns and walks one after the
            other: distance / 33.1 + heading difference / 20.
        least_decisions: no walker needs fewer: the larger of the two terms, since one
            action walks and turns at the same time.
        through_wall: near in the plan, far for a walker: at most ``near_cells`` apart
            straight on, at least twice that on foot.
    """

    distance: Tensor
    straight: Tensor
    heading_difference: Tensor
    decisions: Tensor
    least_decisions: Tensor
    through_wall: Tensor


def pair_truth(
    metric: MazeMetric,
    positions: tuple[Tensor, Tensor],
    headings: tuple[Tensor, Tensor],
    *,
    motion: Motion | None = None,
    near_cells: float = 2.5,
) -> PairTruth:
    """Measure pairs of poses.

    Args:
        metric: of the maze.
        positions: of the anchors and of the others, map units, ``[P, 2]`` each.
        headings: of both, degrees, ``[P]`` or ``[P, 1]`` each.
        motion: what one decision does; ViZDoom's by default.
        near_cells: see ``through_wall`` of `PairTruth`. Parallel corridors are two
            cells apart, and the walkers may stand off their middles.

    Returns:
        The truth about the pairs.

    Raises:
        ValueError: if the shapes differ or a position lies in a wall.

    Examples:
        >>> metric = MazeMetric(torch.ones(1, 4, dtype=torch.bool))
        >>> here, there = torch.tensor([[64.0, 64.0]]), torch.tensor([[130.2, 64.0]])
        >>> truth = pair_truth(
        ...     metric, (here, there), (torch.tensor([350.0]), torch.tensor([30.0]))
        ... )
        >>> truth.decisions, truth.least_decisions  # 66.2 / 33.1 and 40 / 20
        (tensor([4.]), tensor([2.]))
    """
    motion = Motion() if motion is None else motion
    anchor, other = positions
    if anchor.shape != other.shape or anchor.shape[-1:] != (2,):
        raise ValueError(
            f"positions must be two of [P, 2], got {tuple(anchor.shape)} and "
            f"{tuple(other.shape)}."
        )
    turn = wrap_degrees(headings[0].reshape(-1) - headings[1].reshape(-1)).abs()
    distance = metric.geodesic(anchor, other)
    straight = (anchor - other).norm(dim=-1)
    near = near_cells * metric.cell_size
    steps, turns = distance / motion.step, turn / motion.turn
    return PairTruth(
        distance=distance,
        straight=straight,
        heading_difference=turn,
        decisions=steps + turns,
        least_decisions=torch.maximum(steps, turns),
        through_wall=(straight <= near) & (distance >= 2 * near),
    )
