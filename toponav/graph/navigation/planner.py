"""`Planner`: the cheapest paths over a map, by Dijkstra's algorithm."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from toponav.graph.waypoint_graph import check_edges


class Plan(NamedTuple):
    """The cheapest paths from every waypoint to the nearest goal."""

    costs: Tensor  # float64 [W], infinite without a path
    #: int64 ``[W]``; the next waypoint; itself at a goal and where there is no path.
    onward: Tensor


class Planner:
    """Finds the cheapest paths by Dijkstra's algorithm, on edges that may be closed.

    One search from all goals at once gives the path from every waypoint, so that an
    agent that leaves its path needs no new search. Edges ``[E, 2]`` are undirected,
    each once; ``edge_cost`` is ``[E, 2]``, there and back, or ``[E]``.

    Reference:
        The paper, "Goal reaching process", eq. 15.

    Examples:
        >>> edges = torch.tensor([[0, 1], [1, 2], [2, 3], [0, 3]])
        >>> planner = Planner(4, edges, torch.tensor([1.0, 1.0, 1.0, 3.0]))
        >>> planner.plan([2]).costs.tolist(), planner.plan([2]).onward.tolist()
        ([2.0, 1.0, 0.0, 1.0], [1, 2, 2, 2])
    """

    def __init__(self, num_nodes: int, edges: Tensor, edge_cost: Tensor) -> None:
        check_edges(edges, num_nodes)
        if not bool(((edge_cost > 0) & edge_cost.isfinite()).all()):
            got = f"{float(edge_cost.min()):g} to {float(edge_cost.max()):g}"
            raise ValueError(f"edge_cost must be finite and above 0, got {got}")
        self.num_nodes = num_nodes
        self.edges = edges.cpu()
        cost = edge_cost.double().cpu()
        # All edges in one direction, and then all in the other.
        self._cost = (cost if cost.ndim == 2 else cost.expand(2, -1).T).T.flatten()
        self._here, self._there = torch.cat([self.edges, self.edges.flip(1)]).unbind(1)
        keys = self.edges.min(1).values * num_nodes + self.edges.max(1).values
        self._keys, self._order = keys.sort()

    def plan(self, goals: Sequence[int], closed: Tensor | None = None) -> Plan:
        """The paths to the nearest of ``goals`` around ``closed`` edges ``[E]``."""
        here, there, edge_cost = self._here, self._there, self._cost
        if closed is not None:
            is_open = ~closed.cpu().repeat(2)
            here, there, edge_cost = here[is_open], there[is_open], edge_cost[is_open]
        costs = torch.full((self.num_nodes,), torch.inf, dtype=torch.float64)
        if len(goals):
            entries = (edge_cost.numpy(), (there.numpy(), here.numpy()))
            backwards = csr_array(entries, shape=(self.num_nodes, self.num_nodes))
            sources = np.unique(np.asarray(goals))
            costs = torch.from_numpy(
                dijkstra(backwards, indices=sources, min_only=True)
            )
        # Onward is the neighbour through which each cost comes; of several the lowest.
        through = edge_cost + costs[there]
        is_best = (through == costs[here]) & through.isfinite()
        onward = torch.arange(self.num_nodes).scatter_reduce(
            0, here[is_best], there[is_best], "amin", include_self=False
        )
        return Plan(costs, onward)

    def edge_numbers(self, start: Tensor, end: Tensor) -> Tensor:
        """Numbers of the edges that join waypoints ``[*B]``, -1 where there is none."""
        if not len(self._keys):
            return torch.full_like(start, -1)
        keys = torch.minimum(start, end) * self.num_nodes + torch.maximum(start, end)
        at = torch.searchsorted(self._keys, keys).clamp(max=len(self._keys) - 1)
        return torch.where(self._keys[at] == keys, self._order[at], -1)

    def edges_across(
        self, node: int, costs: Tensor, level: float, closed: Tensor, *, hops: int
    ) -> Tensor:
        """Numbers of the open edges from costs ``[W]`` of at least ``level`` to lower.

        They begin at most ``hops`` open edges from ``node``, to be walked without
        coming nearer to the goal than ``level``.
        """
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
