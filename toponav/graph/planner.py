"""`Planner`: the cheapest ways over a map to the nearest of several waypoints."""

from collections.abc import Sequence
from dataclasses import dataclass

import rustworkx as rx
import torch
from torch import Tensor


@dataclass(frozen=True)
class Plan:
    """The ways from every waypoint to the nearest goal.

    Args:
        costs: float64 ``[W]``; of the cheapest way, infinite without one.
        onward: int64 ``[W]``; the next waypoint on it; the waypoint itself at a goal
            and where no way leads on.
    """

    costs: Tensor
    onward: Tensor


class Planner:
    """Finds the cheapest ways by Dijkstra's algorithm, on edges that may be closed.

    One search from all goals at once gives the way from every waypoint, so that an
    agent that is thrown off its path, or mistaken about its place, has the next one
    without a new search. A closed edge has infinite cost, and an infinite way counts as
    none: no path leads through it.

    Reference:
        The paper, "Goal reaching process", eq. 15.

    Args:
        num_nodes: number of waypoints W.
        edges: int64 ``[E, 2]``, undirected, each once.
        edge_cost: ``[E, 2]``, from the first end to the second and back, or ``[E]``,
            the same both ways.

    Raises:
        ValueError: if an edge names no waypoint, or a cost is not finite and positive.

    Examples:
        A square with a dear side; from 0 to 2 by way of 1, and with that way closed:

        >>> edges = torch.tensor([[0, 1], [1, 2], [2, 3], [0, 3]])
        >>> planner = Planner(4, edges, torch.tensor([1.0, 1.0, 1.0, 3.0]))
        >>> plan = planner.plan([2])
        >>> plan.costs.tolist(), plan.onward.tolist()
        ([2.0, 1.0, 0.0, 1.0], [1, 2, 2, 2])
        >>> closed = torch.tensor([True, False, False, False])
        >>> planner.plan([2], closed).onward[0]
        tensor(3)

    Shape notation:
        W: waypoints.  E: edges.
    """

    def __init__(self, num_nodes: int, edges: Tensor, edge_cost: Tensor) -> None:
        if len(edges) and not 0 <= int(edges.min()) <= int(edges.max()) < num_nodes:
            raise ValueError(
                f"edges must join waypoints 0 to {num_nodes - 1}, got "
                f"{int(edges.min())} to {int(edges.max())}"
            )
        if not bool(((edge_cost > 0) & edge_cost.isfinite()).all()):
            raise ValueError(
                "edge_cost must be finite and above 0, got "
                f"{float(edge_cost.min()):g} to {float(edge_cost.max()):g}"
            )
        self.num_nodes = num_nodes
        self.edges = edges.cpu()
        cost = edge_cost.double().cpu()
        # The ways there, and then the ways back.
        self._cost = (cost if cost.ndim == 2 else cost.expand(2, -1).T).T.flatten()
        keys = self.edges.min(1).values * num_nodes + self.edges.max(1).values
        self._keys, self._order = keys.sort()
        # The search goes from the goals back, against the direction of walking.
        here, there = torch.cat([self.edges, self.edges.flip(1)]).T.tolist()
        self._graph = rx.PyDiGraph(multigraph=True)
        self._graph.add_nodes_from(range(num_nodes))
        self._graph.add_edges_from(
            list(zip(there, here, range(len(here)), strict=True))
        )

    def plan(self, goals: Sequence[int], closed: Tensor | None = None) -> Plan:
        """The ways to the nearest of ``goals``.

        Args:
            goals: waypoints; without any, no way leads anywhere.
            closed: bool ``[E]``, edges that must not be used.
        """
        cost = self._cost
        if closed is not None:
            cost = cost.masked_fill(closed.cpu().repeat(2), torch.inf)
        costs = self._search(goals, [*cost.tolist(), 0.0])
        return Plan(costs, self._onward(costs, cost))

    def _search(self, goals: Sequence[int], cost: list[float]) -> Tensor:
        """Dijkstra from a helper node that is joined to all goals at no cost."""
        helper = self._graph.add_node(None)
        try:
            free = len(cost) - 1
            self._graph.add_edges_from([(helper, goal, free) for goal in set(goals)])
            found = rx.dijkstra_shortest_path_lengths(
                self._graph, helper, cost.__getitem__
            )
        finally:
            self._graph.remove_node(helper)
        costs = torch.full((self.num_nodes + 1,), torch.inf, dtype=torch.float64)
        if len(found):
            nodes = torch.tensor(list(found.keys())).clamp(max=self.num_nodes)
            costs[nodes] = torch.tensor(list(found.values()), dtype=torch.float64)
        return costs[:-1]

    def _onward(self, costs: Tensor, edge_cost: Tensor) -> Tensor:
        """The neighbour through which each waypoint's cost comes; ties: the lowest."""
        here, there = torch.cat([self.edges, self.edges.flip(1)]).unbind(1)
        by_way = edge_cost + costs[there]
        best = torch.full_like(costs, torch.inf)
        best = best.scatter_reduce(0, here, by_way, "amin")
        is_best = (by_way == best[here]) & by_way.isfinite() & (costs[here] > 0)
        onward = torch.full_like(costs, self.num_nodes, dtype=torch.int64)
        onward = onward.scatter_reduce(0, here[is_best], there[is_best], "amin")
        stay = torch.arange(self.num_nodes)
        return torch.where(onward == self.num_nodes, stay, onward)

    def edge_numbers(self, start: Tensor, end: Tensor) -> Tensor:
        """Numbers of the edges that join waypoints, -1 where there is none.

        Args:
            start: int64 ``[*B]``.
            end: int64 ``[*B]``.
        """
        if not len(self._keys):
            return torch.full_like(start, -1)
        keys = torch.minimum(start, end) * self.num_nodes + torch.maximum(start, end)
        at = torch.searchsorted(self._keys, keys).clamp(max=len(self._keys) - 1)
        return torch.where(self._keys[at] == keys, self._order[at], -1)

    def edges_across(
        self,
        node: int,
        costs: Tensor,
        level: float,
        *,
        hops: int,
        closed: Tensor | None = None,
    ) -> Tensor:
        """Numbers of the edges that lead across a level of cost, near a waypoint.

        They join waypoints that are at least ``level`` away from the goal with nearer
        ones. *Near* are those that can be walked to from ``node`` without coming nearer
        to the goal than ``level``.

        Args:
            node: a waypoint.
            costs: ``[W]``, of a `Plan`.
            level: cost of the way that is left.
            hops: how many edges from ``node`` to look.
            closed: bool ``[E]``, edges that are none.
        """
        is_open = torch.ones(len(self.edges), dtype=torch.bool)
        if closed is not None:
            is_open = ~closed.cpu()
        one, other = self.edges.unbind(1)
        beyond = costs < level
        near = torch.zeros(self.num_nodes, dtype=torch.bool)
        near[node] = True
        for _ in range(hops):
            step = torch.cat([other[near[one] & is_open], one[near[other] & is_open]])
            near[step] = True
            near &= ~beyond
        across = (near[one] & beyond[other]) | (near[other] & beyond[one])
        return (across & is_open).nonzero().squeeze(1)
