"""`Plans`: which path each agent has, around the edges that it closed."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from toponav.graph.navigation.goals import GoalNodes
from toponav.graph.navigation.planner import Plan, Planner


class Cut(NamedTuple):
    """Edges that an agent has closed together."""

    edges: Tensor  # int64 [K]
    opens: float  # when they open again, in decisions since the plans were made
    failed: int  # how often they had been closed and opened before


class Plans:
    """Keeps one plan an agent, to be planned again when goals or closed edges change.

    An agent that fails to get through makes a *cut*: it closes the edge that failed and
    those beside it. They open again together after ``fade_after`` decisions, times
    ``fade_growth`` for each time that they had opened before and failed again: what
    fails again is more likely blocked than mistaken. When no path is left, those open
    first that failed least often, of these the newest, since there was a path until it
    was made. Places are int64 ``[N]``, -1 for an agent without one.

    Reference:
        The paper, "Goal reaching process": "find the connections that traverse
        blockages and set their path cost to infinity".
    """

    def __init__(
        self,
        planner: Planner,
        goals: GoalNodes,
        *,
        fade_after: int | None = None,
        fade_growth: float = 1.0,
    ) -> None:
        self.planner = planner
        self.goals = goals
        self.fade_after = math.inf if fade_after is None else fade_after
        self.fade_growth = fade_growth
        num_agents, num_nodes = len(goals.nodes), planner.num_nodes
        #: Edges that are closed, bool ``[N, E]``.
        self.closed = torch.zeros(num_agents, len(planner.edges), dtype=torch.bool)
        # How often each edge was closed in this episode.
        self._failed = torch.zeros(num_agents, len(planner.edges), dtype=torch.int64)
        # The cuts of each agent that are closed, the oldest first.
        self._cuts: list[list[Cut]] = [[] for _ in range(num_agents)]
        #: How often each agent's plan was made, int64 ``[N]``.
        self.num_plans = torch.zeros(num_agents, dtype=torch.int64)
        self._now = 0
        # What `Plan` holds, one row an agent.
        self._costs = torch.full((num_agents, num_nodes), torch.inf).double()
        self._onward = torch.arange(num_nodes).repeat(num_agents, 1)
        # The waypoint where the path from each waypoint ends.
        self._end = self._onward.clone()

    def plan(self, agents: Sequence[int]) -> None:
        """Plan again for some agents."""
        for agent in agents:
            self.num_plans[agent] += 1
            costs, end = self._search(agent, self.closed[agent])
            self._costs[agent], self._onward[agent] = costs, end
            # Each round doubles the steps taken along all paths at once.
            for _ in range(len(end).bit_length()):
                end = end[end]
            self._end[agent] = end

    def _search(self, agent: int, closed: Tensor) -> Plan:
        goals = self.goals.nodes[agent][self.goals.active[agent]].tolist()
        return self.planner.plan(goals, closed)

    def cost(self, place: Tensor) -> Tensor:
        """Remaining cost from each agent's place, float64 ``[N]``, or infinite."""
        found = self._costs.gather(1, place.clamp(min=0).unsqueeze(1)).squeeze(1)
        return found.masked_fill(place < 0, torch.inf)

    @property
    def costs(self) -> Tensor:
        """Remaining cost from every waypoint, float64 ``[N, W]``, or infinite."""
        return self._costs

    @property
    def has_path(self) -> Tensor:
        """From which waypoints each agent has a path to its goal, bool ``[N, W]``."""
        return self._costs.isfinite()

    def ahead(self, place: Tensor, length: int) -> Tensor:
        """The next waypoints, ``[N, length]``; where a path ends, its last repeats."""
        found, node = [], place.clamp(min=0).unsqueeze(1)
        for _ in range(length):
            node = self._onward.gather(1, node)
            found.append(node)
        return torch.cat(found, 1)

    def end(self, place: Tensor) -> Tensor:
        """The last waypoint on each agent's path, int64 ``[N]``, -1 without a path."""
        node = self._end.gather(1, place.clamp(min=0).unsqueeze(1)).squeeze(1)
        return node.masked_fill(self.cost(place).isinf(), -1)

    def is_closed_to(self, place: Tensor, path: Tensor) -> Tensor:
        """Whether a closed edge joins each place with those of a path ``[N, L]``."""
        if not self.closed.any():
            return torch.zeros_like(path, dtype=torch.bool)
        start = place.clamp(min=0).unsqueeze(1).expand_as(path)
        edge = self.planner.edge_numbers(start, path)
        return self.closed.gather(1, edge.clamp(min=0)) & (edge >= 0)

    @property
    def num_cuts(self) -> Tensor:
        """How many cuts of each agent are closed, int64 ``[N]``."""
        return torch.tensor([len(cuts) for cuts in self._cuts])

    def cut(self, agent: int, edges: Tensor) -> None:
        """Close edges of one agent, int64 ``[K]``, together; without any, no cut."""
        if not len(edges):
            return
        # What another cut keeps closed has not failed again.
        fresh = edges[~self.closed[agent, edges]]
        failed = int(self._failed[agent, fresh].median()) if len(fresh) else 0
        lasts = self.fade_after * self.fade_growth**failed
        self._cuts[agent].append(Cut(edges, self._now + lasts, failed))
        self._failed[agent, fresh] += 1
        self.closed[agent, edges] = True

    def close(self, agent: int, place: int, level: float, *, hops: int) -> int:
        """Cut what leads nearer to the goal than a cost ``level``, near a place.

        ``hops`` are halved until a path would be left from there, or to 0. Returns the
        waypoint to which the path led on.
        """
        onward = int(self._onward[agent, place])
        closed, costs = self.closed[agent], self._costs[agent].clone()
        while True:
            edges = self.planner.edges_across(place, costs, level, closed, hops=hops)
            then = closed.index_fill(0, edges, True)
            if not hops or self._search(agent, then).costs[place].isfinite():
                break
            hops //= 2
        self.cut(agent, edges)
        self.plan([agent])
        return onward

    def close_edge(self, agent: int, place: int) -> int:
        """Cut the one edge by which the path leads on from a place; its other end."""
        onward = int(self._onward[agent, place])
        ends = torch.tensor([[place], [onward]])
        self.cut(agent, self.planner.edge_numbers(*ends))
        self.plan([agent])
        return onward

    def close_all(self, agent: int, place: int, edges: Tensor) -> tuple[int, int]:
        """Cut ``edges`` ``[K]`` together; the ends of the first on the path, or -1."""
        ends = -1, -1
        for _ in range(self.planner.num_nodes):
            onward = int(self._onward[agent, place])
            if onward == place:
                break
            number = self.planner.edge_numbers(
                torch.tensor([[place]]), torch.tensor([[onward]])
            )
            if (edges == number.flatten()).any():
                ends = place, onward
                break
            place = onward
        self.cut(agent, edges)
        self.plan([agent])
        return ends

    def reopen_first(self, agent: int) -> bool:
        """Open the cut that failed least often, of these the newest; if any."""
        cuts = self._cuts[agent]
        if cuts:
            self._reopen(agent, min(reversed(cuts), key=lambda cut: cut.failed))
        return len(cuts) > 0

    def _reopen(self, agent: int, cut: Cut) -> None:
        """Open one of an agent's cuts; what others close stays closed."""
        # By identity, as tensors are not compared by value here.
        kept = [other for other in self._cuts[agent] if other is not cut]
        self._cuts[agent] = kept
        self.closed[agent, cut.edges] = False
        for other in kept:
            self.closed[agent, other.edges] = True

    def open_up(self, place: Tensor) -> None:
        """Open cuts of agents without a path, until there is one."""
        stranded = (place >= 0) & self.cost(place).isinf()
        for agent in stranded.nonzero().flatten().tolist():
            while self._costs[agent, place[agent]].isinf():
                if not self.reopen_first(agent):
                    break
                self.plan([agent])

    def open_all(self, agents: Tensor) -> None:
        """Open everything for the agents of a mask, bool ``[N]``."""
        self.closed[agents], self._failed[agents] = False, 0
        for agent in agents.nonzero().flatten().tolist():
            self._cuts[agent].clear()

    def pass_decision(self) -> Tensor:
        """Count a decision; cuts that are old enough open, of agents bool ``[N]``."""
        self._now += 1
        changed = torch.zeros(len(self._cuts), dtype=torch.bool)
        for agent, cuts in enumerate(self._cuts):
            for cut in [cut for cut in cuts if cut.opens <= self._now]:
                self._reopen(agent, cut)
                changed[agent] = True
        return changed
