"""The truths that a diagnosis tells a navigator: place, edges, and how to steer.

They read privileged keys, and no agent gets them.
"""

from collections.abc import Callable

import numpy as np
import torch
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from toponav.builders import GroundTruth
from toponav.ground_truth import Steering, bearing, cell_centres, wrap_degrees
from toponav.keys import (
    ACTION,
    BLOCKED,
    CELL,
    GOAL_CELL,
    HEADING,
    PLACE,
    POSITION,
    TARGET,
    TRUE_PLACE,
    select_entries,
)
from toponav.worlds import Motion, WorldSpec

#: Cells of a route that steering looks at.
_HOPS = 3
#: A waypoint is reached, but for its direction, within this share of a step.
_THERE = 0.75
#: True edges join views up to so many cells and degrees apart, of which there is one
#: in each so long part of a cell for each so wide a direction.
_AWAY, _TURN, _PART, _DIRECTION = 1.1, 100.0, 0.5, 45.0


class TruePlace(TensorDictModuleBase):
    """Writes which of a map's waypoints is the nearest to each agent.

    Nearest in decisions: the steps to it and the turns to look its way, among the
    waypoints in the agent's cell, or among all on foot if there is none.

    Args:
        truth: of the maze and of the map's waypoints.
        world: whose decisions count.
    """

    in_keys = [POSITION, HEADING]
    out_keys = [TRUE_PLACE]

    def __init__(self, truth: GroundTruth, *, world: WorldSpec) -> None:
        super().__init__()
        self.truth = truth
        self.motion = Steering(world).motion
        self._cells = truth.distances.cell_numbers(truth.poses[:, :2])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        data = select_entries(tensordict, self.in_keys).reshape(-1).cpu()
        position, poses = data[POSITION], self.truth.poses
        distances = self.truth.distances
        away = torch.cdist(position, poses[:, :2])
        elsewhere = distances.cell_numbers(position).unsqueeze(1) != self._cells
        alone = elsewhere.all(1)
        if alone.any():
            here = position[alone].unsqueeze(1).expand(-1, len(poses), -1)
            away[alone] = distances.geodesic(here, poses[:, :2].expand_as(here))
            elsewhere[alone] = False
        turned = wrap_degrees(data[HEADING] - poses[:, 2]).abs()
        cost = away / self.motion.step + turned / self.motion.turn
        nearest = cost.masked_fill(elsewhere, torch.inf).argmin(1)
        place = nearest.reshape(*tensordict.batch_size, 1).to(tensordict.device)
        return tensordict.set(TRUE_PLACE, place)


class TrueSteering(TensorDictModuleBase):
    """Replaces the action by one that leads to the navigator's target.

    It follows the shortest route to where the target was seen, around closed slots, and
    turns there until it looks the same way; at the goal's own waypoint it goes to the
    goal. The actions of an agent that is lost stay as they are.

    Args:
        truth: of the maze and of the map's waypoints.
        world: that it steers in.
        tell: gets the actions, ``[N]``, such as a navigator that goes by its last one.
    """

    in_keys = [ACTION, PLACE, TARGET, POSITION, HEADING, CELL, GOAL_CELL, BLOCKED]
    out_keys = [ACTION]

    def __init__(
        self,
        truth: GroundTruth,
        *,
        world: WorldSpec,
        tell: Callable[[Tensor], None] | None = None,
    ) -> None:
        super().__init__()
        self.truth = truth
        self.tell = tell
        self.steering = Steering(world)
        routes = truth.distances.routes
        size = self.steering.motion.cell_size
        self._centres = cell_centres(routes.cells, routes.shape[0], size)
        self._cells = truth.distances.cell_numbers(truth.poses[:, :2])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        data = select_entries(tensordict, self.in_keys).reshape(-1).cpu()
        action = data[ACTION]
        knows = data[PLACE].squeeze(1) >= 0
        steered = self._steer(data[knows]) if knows.any() else action[:0]
        action = action.masked_scatter(knows, steered)
        if self.tell is not None:
            self.tell(action)
        action = action.reshape(tensordict.batch_size).to(tensordict.device)
        return tensordict.set(ACTION, action)

    def _steer(self, data: TensorDictBase) -> Tensor:
        routes, motion = self.truth.distances.routes, self.steering.motion
        target = data[TARGET].squeeze(1)
        at_goal = target < 0
        goal = routes.number(data[GOAL_CELL].clamp(min=0))
        pose = self.truth.poses[target]
        aim = torch.where(at_goal.unsqueeze(1), self._centres[goal], pose[:, :2])
        end = torch.where(at_goal, goal, self._cells[target])
        position, heading = data[POSITION], data[HEADING].squeeze(1)
        table, here = routes.tables(data[BLOCKED]), routes.number(data[CELL])
        path = self._centres[routes.path(table, here, end, hops=_HOPS)]
        along = self.steering(path, position, heading)
        # Nothing stands between two points of the same or of neighbouring cells.
        straight = self.steering.towards(wrap_degrees(bearing(position, aim) - heading))
        is_beside = routes.distances[table, here, end] <= 1
        is_there = (position - aim).norm(dim=1) <= _THERE * motion.step
        turn = self.steering.towards(wrap_degrees(pose[:, 2] - heading))
        action = torch.where(is_beside, straight, along)
        return torch.where(is_there & is_beside & ~at_goal, turn, action)


def true_edges(truth: GroundTruth, *, world: WorldSpec) -> tuple[Tensor, Tensor]:
    """The edges that a map of these waypoints should have, and their costs.

    One waypoint stands for each half of a cell, east and north, and each direction of
    45 degrees. Those of them that lie within 1.1 cells on foot and look at most 100
    degrees apart are joined, and each other waypoint is joined with the one that stands
    for it. Where waypoints are so few that parts are left, the cheapest walks between
    these join them. Costs are decisions, steps and turns.

    Returns:
        Edges, int64 ``[E, 2]``, the lower waypoint first, and float32 ``[E]``.
    """
    motion, poses = Steering(world).motion, truth.poses
    part = (poses[:, :2] / (_PART * motion.cell_size)).floor()
    direction = (poses[:, 2:] / _DIRECTION).round() % (360 / _DIRECTION)
    group = torch.cat([part, direction], 1).unique(dim=0, return_inverse=True)[1]
    numbers = torch.arange(len(poses))
    first = torch.full((int(group.max()) + 1,), len(poses))
    first.scatter_reduce_(0, group, numbers, "amin")
    stands, chosen = first[group], first.sort().values
    gap = torch.cdist(poses[chosen, :2], poses[chosen, :2])
    near = _AWAY * motion.cell_size
    pairs = chosen[(gap <= near).triu(1).nonzero()]
    rest = (stands != numbers).nonzero().flatten()
    edges = torch.cat([pairs, torch.stack([stands[rest], rest], 1)])
    away, turned = _walks(truth, edges)
    kept = (away <= near) & (turned <= _TURN)
    edges = edges[kept]
    edges = torch.cat([edges, _between_parts(truth, edges, chosen, motion)])
    away, turned = _walks(truth, edges)
    cost = away / motion.step + turned / motion.turn
    return edges, cost.clamp(min=0.1).float()


def _walks(truth: GroundTruth, pairs: Tensor) -> tuple[Tensor, Tensor]:
    """Map units on foot and degrees between the waypoints of pairs ``[P, 2]``."""
    one, other = truth.poses[pairs].unbind(1)
    away = truth.distances.geodesic(one[:, :2], other[:, :2])
    return away, wrap_degrees(one[:, 2] - other[:, 2]).abs()


def _between_parts(
    truth: GroundTruth, edges: Tensor, among: Tensor, motion: Motion
) -> Tensor:
    """The cheapest pairs ``[P, 2]`` of some waypoints that join the parts of a map."""
    num, ones = len(truth.poses), np.ones(len(edges))
    joined = csr_array((ones, tuple(edges.T.numpy())), shape=(num, num))
    num_parts, part = connected_components(joined, directed=False)
    if num_parts == 1:
        return edges[:0]
    pairs = among[torch.combinations(torch.arange(len(among)))]
    pairs = pairs[torch.from_numpy(np.diff(part[pairs.numpy()])[:, 0] != 0)]
    away, turned = _walks(truth, pairs)
    pairs = pairs[(away / motion.step + turned / motion.turn).argsort()]
    # Of each two parts the cheapest walk, then of these the cheapest that are needed.
    ends = np.sort(part[pairs.numpy()], 1)
    first = np.sort(np.unique(ends, axis=0, return_index=True)[1])
    parts = DisjointSet(range(num_parts))
    return pairs[[one for one in first.tolist() if parts.merge(*ends[one].tolist())]]
