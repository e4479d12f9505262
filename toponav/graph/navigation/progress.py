"""`Progress`, `EdgeProgress`: whether agents come nearer to goal or next waypoint."""

import math

import torch
from torch import Tensor

#: One in this many costs of a window may be below the level that counts as reached:
#: some places are mistaken, and a few mistakes must not count.
_MISTAKEN = 8
# A cut is soon after another within this many times the patience.
_SOON = 2
#: Edges: beyond any map, and twice as many are still an int64.
_FARTHEST = 2**32


class Progress:
    """Watches the remaining cost of each agent's path over its last decisions.

    An agent is *stuck* once the second half of its last ``patience`` decisions brought
    it no nearer to the goal than the first half, by the median of the remaining cost,
    since it mistakes its place now and then. With ``None`` it is never stuck. The
    *reach* of a cut grows with each that comes soon after another: 0, 1, 3, 7 and so on
    edges around the place.

    Reference:
        The paper, "Goal reaching process": "if the goal is not reached within a certain
        number of time steps". Here it is counted from each new plan.
    """

    def __init__(self, num_agents: int, *, patience: int | None) -> None:
        self.patience = patience
        length = patience or 1
        # The last decisions with a path to the goal, the newest last.
        self._cost = torch.zeros(num_agents, length, dtype=torch.float64)
        self._place = torch.full((num_agents, length), -1)
        self._count = torch.zeros(num_agents, dtype=torch.int64)
        # Reach of the next cut, if it comes soon after the last one.
        self._reach = torch.zeros(num_agents, dtype=torch.int64)
        self._since_cut = torch.zeros(num_agents, dtype=torch.int64)

    def restart(self, agents: Tensor) -> None:
        """Begin to watch the agents of a mask, bool ``[N]``, as their plan is new."""
        self._count[agents] = 0

    def forget(self, agents: Tensor) -> None:
        """Begin again with the agents of a mask, bool ``[N]``, put elsewhere."""
        self.restart(agents)
        self._reach[agents] = 0

    def watch(self, place: Tensor, cost: Tensor) -> Tensor:
        """Record place and remaining cost of each walking agent; which are stuck."""
        if self.patience is None:
            return torch.zeros(len(place), dtype=torch.bool)
        walks = (place >= 0) & cost.isfinite() & (cost > 0)
        for kept, new in ((self._cost, cost.double()), (self._place, place)):
            kept[walks] = torch.cat([kept[walks, 1:], new[walks].unsqueeze(1)], 1)
        self._count += walks
        self._since_cut += walks
        self._reach[self._since_cut > _SOON * self.patience] = 0
        half = self.patience // 2
        before = self._cost[:, :half].median(1).values
        since = self._cost[:, -half:].median(1).values
        return walks & (self._count >= self.patience) & (since >= before)

    def give_up(self, agent: int) -> tuple[int, float, int]:
        """Where an agent came nearest to its goal, the cost there, the cut's reach."""
        number = self._cost.shape[1] // _MISTAKEN + 1
        nearest = self._cost[agent].kthvalue(number)
        reach = int(self._reach[agent])
        self._reach[agent] = min(2 * reach + 1, _FARTHEST)
        self._since_cut[agent] = self._count[agent] = 0
        return int(self._place[agent, nearest.indices]), float(nearest.values), reach


class EdgeProgress:
    """Watches whether each agent gets over the next edge of its path, as `Progress`.

    An agent is *stuck* once ``patience`` decisions brought it to no waypoint of a lower
    remaining cost than that where it came nearest to the goal: it did not pass the edge
    that leads on from there, and gives up this one alone.

    Reference:
        The paper, "Goal reaching process" and Fig. 11.
    """

    def __init__(self, num_agents: int, *, patience: int | None) -> None:
        self.patience = math.inf if patience is None else patience
        self._nearest = torch.full((num_agents,), torch.inf, dtype=torch.float64)
        self._place = torch.full((num_agents,), -1)
        # Decisions since it got there, it included.
        self._count = torch.zeros(num_agents, dtype=torch.int64)

    def restart(self, agents: Tensor) -> None:
        self._nearest[agents] = torch.inf

    forget = restart

    def watch(self, place: Tensor, cost: Tensor) -> Tensor:
        walks = (place >= 0) & cost.isfinite() & (cost > 0)
        is_nearer = walks & (cost < self._nearest)
        self._nearest[is_nearer] = cost[is_nearer].double()
        self._place[is_nearer] = place[is_nearer]
        self._count = (self._count + walks).masked_fill(is_nearer, 1)
        return walks & (self._count >= self.patience)

    def give_up(self, agent: int) -> tuple[int, float, None]:
        """Where the edge begins that was not passed, the cost there, and no reach."""
        found = int(self._place[agent]), float(self._nearest[agent]), None
        self._nearest[agent] = torch.inf
        return found
