"""`Ways`: the plan of each agent, with the edges that it found closed."""

from collections.abc import Sequence

import torch
from torch import Tensor

from toponav.graph.blockages import Blockages
from toponav.graph.goal_nodes import GoalNodes
from toponav.graph.planner import Plan, Planner


class Ways:
    """Keeps one plan an agent, and makes it anew when goals or closed edges change.

    Args:
        planner: of the map.
        goals: the goal waypoints of each agent.
        blockages: what each agent found closed.

    Examples:
        >>> planner = Planner(3, torch.tensor([[0, 1], [1, 2]]), torch.ones(2))
        >>> goals = GoalNodes()
        >>> goals.resize(1, 1, 4)
        >>> goals.nodes[0], goals.counts[0] = 2, True
        >>> ways = Ways(planner, goals, Blockages(1, 2))
        >>> ways.plan([0])
        >>> ways.cost(torch.tensor([0])), ways.ahead(torch.tensor([0]), 2)
        (tensor([2.], dtype=torch.float64), tensor([[1, 2]]))

    Shape notation:
        N: agents.  W: waypoints.
    """

    def __init__(
        self, planner: Planner, goals: GoalNodes, blockages: Blockages
    ) -> None:
        self.planner = planner
        self.goals = goals
        self.blockages = blockages
        size = (len(blockages.closed), planner.num_nodes)
        # What `Plan` holds, one row an agent.
        self._costs = torch.full(size, torch.inf, dtype=torch.float64)
        self._onward = torch.arange(size[1]).expand(size).clone()
        # The waypoint where each way ends.
        self._end = self._onward.clone()

    def plan(self, agents: Sequence[int]) -> None:
        """Make the plans of some agents anew."""
        for agent in agents:
            plan = self._search(agent, self.blockages.closed[agent])
            self._costs[agent] = plan.costs
            self._onward[agent] = end = plan.onward
            # Each round doubles the steps taken along all ways at once.
            for _ in range(len(end).bit_length()):
                end = end[end]
            self._end[agent] = end

    def cost(self, place: Tensor) -> Tensor:
        """Cost of the way that is left from each agent's place.

        Args:
            place: int64 ``[N]``.

        Returns:
            float64 ``[N]``; infinite without a way, and for a place of -1.
        """
        found = self._costs.gather(1, place.clamp(min=0).unsqueeze(1)).squeeze(1)
        return found.masked_fill(place < 0, torch.inf)

    def ahead(self, place: Tensor, length: int) -> Tensor:
        """The next waypoints on each agent's way.

        Args:
            place: int64 ``[N]``; -1 is taken for 0.
            length: how many.

        Returns:
            int64 ``[N, length]``; where a way ends, its last waypoint repeats.
        """
        found, node = [], place.clamp(min=0).unsqueeze(1)
        for _ in range(length):
            node = self._onward.gather(1, node)
            found.append(node)
        return torch.cat(found, 1)

    def onward(self, agent: int, node: int) -> int:
        """The next waypoint on an agent's way from a waypoint, or itself."""
        return int(self._onward[agent, node])

    def leaps(self, place: Tensor, path: Tensor) -> Tensor:
        """Which waypoints ahead an agent would reach by an edge that it found closed.

        Args:
            place: int64 ``[N]``.
            path: int64 ``[N, L]``, of `ahead`.

        Returns:
            bool ``[N, L]``.
        """
        start = place.clamp(min=0).unsqueeze(1).expand_as(path)
        edge = self.planner.edge_numbers(start, path)
        if not self.blockages.closed.any():
            return torch.zeros_like(edge, dtype=torch.bool)
        return self.blockages.closed.gather(1, edge.clamp(min=0)) & (edge >= 0)

    def end(self, place: Tensor) -> Tensor:
        """The last waypoint on each agent's way, int64 ``[N]``, -1 without a way."""
        node = self._end.gather(1, place.clamp(min=0).unsqueeze(1)).squeeze(1)
        return node.masked_fill(self.cost(place).isinf(), -1)

    def open_up(self, place: Tensor) -> None:
        """Open the oldest cuts of agents that no way leads on, until one does.

        Args:
            place: int64 ``[N]``.
        """
        stranded = (place >= 0) & self.cost(place).isinf()
        for agent in stranded.nonzero().flatten().tolist():
            while self._costs[agent, place[agent]].isinf():
                if not self.blockages.reopen_oldest(agent):
                    break
                self.plan([agent])

    def close(self, agent: int, place: int, level: float, *, hops: int) -> None:
        """Close what leads nearer to the goal than a level, near a place; plan anew.

        If no way would be left from there, less is closed: what lies half as far away,
        and so on, at last the edges of the place alone.

        Args:
            agent: its number.
            place: the waypoint where it did not get on.
            level: the cost of the way that was left there.
            hops: how many edges from there to look.
        """
        closed, costs = self.blockages.closed[agent], self._costs[agent].clone()
        while True:
            edges = self.planner.edges_across(
                place, costs, level, hops=hops, closed=closed
            )
            then = closed.index_fill(0, edges, True)
            if not hops or self._search(agent, then).costs[place].isfinite():
                break
            hops //= 2
        self.blockages.cut(agent, edges)
        self.plan([agent])

    def _search(self, agent: int, closed: Tensor) -> Plan:
        """The ways to an agent's goals if these edges were closed, bool ``[E]``."""
        goals = self.goals.nodes[agent][self.goals.active[agent]].tolist()
        return self.planner.plan(goals, closed)
