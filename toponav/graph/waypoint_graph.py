"""`WaypointGraph`: which waypoints are neighbours, and the evidence for each edge."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import networkx as nx
import torch
from torch import Tensor

#: What is known of each edge, a row each.
_ARRAYS = ("edges", "traversals", "edge_similarity")


class WaypointGraph:
    """Undirected edges between waypoints 0 to W - 1.

    Each knows in which direction it was traversed: who walked from one view to another
    seldom knows how to walk back, looking the same way.

    Examples:
        >>> graph = WaypointGraph(untraversed_edge_cost=3.0)
        >>> nodes = [graph.add_waypoint() for _ in range(4)]
        >>> graph.link(0, [1], [0.9])
        >>> graph.traverse(2, 1)
        >>> graph.edges.tolist(), graph.edge_cost.tolist()
        ([[0, 1], [1, 2]], [[3.0, 3.0], [3.0, 1.0]])
    """

    def __init__(self, *, untraversed_edge_cost: float = 3.0) -> None:
        self.untraversed_edge_cost = untraversed_edge_cost
        #: Counts the changes of waypoints and edges.
        self.version = 0
        self._graph: nx.Graph[int] = nx.Graph()
        self._arrays: tuple[Tensor, Tensor, Tensor] | None = None
        self._nearby: dict[tuple[int, int], list[int]] = {}

    @property
    def edges(self) -> Tensor:
        """Each once, the lower waypoint first, in order; int64 ``[E, 2]``."""
        return self._edge_arrays()[0]

    @property
    def traversals(self) -> Tensor:
        """How often each edge was traversed, there and back; int64 ``[E, 2]``."""
        return self._edge_arrays()[1]

    @property
    def edge_similarity(self) -> Tensor:
        """Similarity of each edge's ends, NaN if not compared; float32 ``[E]``."""
        return self._edge_arrays()[2]

    @property
    def edge_cost(self) -> Tensor:
        """From the lower waypoint to the other, and back; float32 ``[E, 2]``."""
        cost = torch.where(self.traversals > 0, 1.0, self.untraversed_edge_cost)
        return cost.to(torch.float32)

    def _edge_arrays(self) -> tuple[Tensor, Tensor, Tensor]:
        if self._arrays is None:
            rows = sorted(
                (one, other, *found["traversals"], found["similarity"])
                for one, other, found in self._graph.edges.data()
            )
            table = torch.tensor(rows, dtype=torch.float64).reshape(-1, 5)
            ends, traversals = table[:, :4].long().chunk(2, 1)
            similarity = table[:, 4].float()
            self._arrays = ends.contiguous(), traversals.contiguous(), similarity
        return self._arrays

    def _change(self) -> None:
        self.version += 1
        self._arrays = None
        self._nearby.clear()

    def _evidence(self, one: int, other: int) -> dict[str, Any]:
        """Of an edge, which may be new; its lower end's traversals come first."""
        if not self._graph.has_edge(one, other):
            self._graph.add_edge(one, other, traversals=[0, 0], similarity=math.nan)
        evidence: dict[str, Any] = self._graph[one][other]
        return evidence

    def add_waypoint(self) -> int:
        """Add a waypoint without edges; its number."""
        self._change()
        number = len(self._graph)
        self._graph.add_node(number)
        return number

    def traverse(self, one: int, other: int) -> None:
        """Count a traversal from one waypoint to another; the edge may be new."""
        if one == other:
            return
        traversals, way = self._evidence(one, other)["traversals"], int(one > other)
        traversals[way] += 1
        if traversals[way] == 1:
            self._change()
        else:  # neither its cost nor its ends changed
            self._arrays = None

    def has_edge(self, one: int, other: int) -> bool:
        """Whether an edge joins two waypoints, given in either order."""
        return other in self._graph[one]

    def link(
        self, one: int, others: Sequence[int], similarities: Sequence[float]
    ) -> None:
        """Join a waypoint with others that it reaches, and store their similarities."""
        for other, similarity in zip(others, similarities, strict=True):
            if other != one:
                self._evidence(one, other)["similarity"] = similarity
        if len(others):
            self._change()

    def update_similarities(self, similarity: Tensor, least: float) -> int:
        """Give all edges new similarities ``[E]``.

        Those never traversed and not above ``least`` go and are counted.
        """
        ends = self.edges.tolist()
        for (one, other), value in zip(ends, similarity.tolist(), strict=True):
            evidence = self._evidence(one, other)
            evidence["similarity"] = value
            if not any(evidence["traversals"]) and not value > least:
                self._graph.remove_edge(one, other)
        self._change()
        return len(ends) - len(self.edges)

    def merge(self, into: Tensor) -> None:
        """Unite waypoints: traversals add up, and the highest similarity stays.

        ``into``, int64 ``[W]``, has the new number of each, 0 to W' - 1.
        """
        number, before = into.tolist(), self._graph.edges.data()
        self._clear(max(number, default=-1) + 1)
        for one, other, found in before:
            one, other = number[one], number[other]
            if one == other:
                continue
            evidence, way = self._evidence(one, other), int(one > other)
            evidence["traversals"][way] += found["traversals"][0]
            evidence["traversals"][1 - way] += found["traversals"][1]
            # NaN is no similarity: any number beats it, and it beats none.
            known = filter(math.isfinite, (evidence["similarity"], found["similarity"]))
            evidence["similarity"] = max(known, default=math.nan)

    def rebuild(self, num_waypoints: int, moves: Mapping[tuple[int, int], int]) -> None:
        """Reset to ``num_waypoints`` waypoints with edges where there were ``moves``.

        ``moves`` have the traversals from one waypoint to another.
        """
        self._clear(num_waypoints)
        for (one, other), count in moves.items():
            self._evidence(one, other)["traversals"][int(one > other)] += count
        self._change()

    def _clear(self, num_waypoints: int) -> None:
        """Reset to ``num_waypoints`` waypoints without edges."""
        self._graph = nx.empty_graph(num_waypoints)
        self._change()

    def state_dict(self) -> dict[str, Any]:
        """Copies of ``edges``, ``traversals`` and ``edge_similarity``; the version."""
        arrays = {name: getattr(self, name).clone() for name in _ARRAYS}
        return {**arrays, "version": self.version}

    def load_state_dict(self, state: Mapping[str, Any], num_waypoints: int) -> None:
        """Replace all waypoints and edges by those of a `state_dict`."""
        check_edges(state["edges"], num_waypoints)
        before = self.version
        self._clear(num_waypoints)
        rows = zip(*(state[name].tolist() for name in _ARRAYS), strict=True)
        for (one, other), counts, similarity in rows:
            counts = counts if one < other else counts[::-1]
            self._graph.add_edge(one, other, traversals=counts, similarity=similarity)
        # Another map may have counted as many changes.
        self.version = state["version"] + (0 < before == state["version"])

    def neighbours(self, waypoint: int) -> list[int]:
        """Numbers of the waypoints that an edge joins with this one, in order."""
        return sorted(self._graph[waypoint])

    def nearby(self, waypoint: int, most: int) -> list[int]:
        """Up to ``most`` nearest waypoints by edges, traversed ones first, in order."""
        if (waypoint, most) not in self._nearby:
            found, front = {waypoint: None}, [waypoint]
            while front and len(found) < most:
                beside = {
                    other: not any(evidence["traversals"])
                    for one in front
                    for other, evidence in self._graph[one].items()
                    if other not in found
                }
                front = sorted(beside, key=lambda other: (beside[other], other))
                found |= dict.fromkeys(front)
            self._nearby[waypoint, most] = sorted([*found][:most])
        return self._nearby[waypoint, most]


def check_edges(edges: Tensor, num_waypoints: int) -> None:
    """Raise ``ValueError`` unless edges ``[E, 2]`` join waypoints of a map."""
    if len(edges) and not 0 <= int(edges.min()) <= int(edges.max()) < num_waypoints:
        rule = f"edges must join waypoints 0 to {num_waypoints - 1}"
        raise ValueError(f"{rule}, got {edges.min()} to {edges.max()}")
