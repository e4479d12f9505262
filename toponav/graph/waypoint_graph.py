"""`WaypointGraph`: which waypoints are neighbours, and the evidence for each edge."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import rustworkx
import torch
from torch import Tensor


@dataclass
class Evidence:
    """How often an edge was traversed, from its lower waypoint and back."""

    there: int = 0
    back: int = 0
    similarity: float = math.nan  # of its ends when last compared, if ever

    @property
    def is_traversed(self) -> bool:
        return self.there + self.back > 0


class WaypointGraph:
    """Edges between waypoints 0 to W - 1, stored by rustworkx.

    Edges are undirected, but each knows in which direction it was traversed: an agent
    that walked from one view to another seldom knows how to walk back, since that is
    backwards, looking the same way.

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
        self._graph = rustworkx.PyGraph(multigraph=False)
        self._arrays: tuple[Tensor, Tensor, Tensor] | None = None
        self._nearby: dict[tuple[int, int], list[int]] = {}

    def restore(
        self,
        num_waypoints: int,
        edges: Tensor,
        traversals: Tensor,
        similarity: Tensor,
        *,
        version: int,
    ) -> None:
        """Replace all waypoints and edges, ``[E, 2]``, by those of the properties."""
        if len(edges) and not 0 <= int(edges.min()) <= int(edges.max()) < num_waypoints:
            got = f"{int(edges.min())} to {int(edges.max())}"
            raise ValueError(
                f"edges must join waypoints 0 to {num_waypoints - 1}, got {got}"
            )
        columns = (edges.tolist(), traversals.tolist(), similarity.tolist())
        rows = zip(*columns, strict=True)
        found = {}
        for (one, other), (there, back), value in rows:
            if one > other:
                one, other, there, back = other, one, back, there
            found[one, other] = Evidence(there, back, value)
        self._replace(num_waypoints, found)
        self.version = version

    def _replace(
        self, num_waypoints: int, edges: Mapping[tuple[int, int], Evidence]
    ) -> None:
        self._graph = rustworkx.PyGraph(multigraph=False)
        self._graph.add_nodes_from([None] * num_waypoints)
        self._graph.add_edges_from([(*ends, edges[ends]) for ends in sorted(edges)])
        self._change()

    @property
    def num_waypoints(self) -> int:
        return int(self._graph.num_nodes())

    @property
    def edges(self) -> Tensor:
        """Each edge once, the lower waypoint first, in order; int64 ``[E, 2]``."""
        return self._edge_arrays()[0]

    @property
    def traversals(self) -> Tensor:
        """How often each edge was traversed, there and back, int64 ``[E, 2]``."""
        return self._edge_arrays()[1]

    @property
    def edge_similarity(self) -> Tensor:
        """Similarity of each edge's ends, NaN if not compared, float32 ``[E]``."""
        return self._edge_arrays()[2]

    @property
    def edge_cost(self) -> Tensor:
        """float32 ``[E, 2]``: from the lower waypoint to the other, and back."""
        cost = torch.where(self.traversals > 0, 1.0, self.untraversed_edge_cost)
        return cost.to(torch.float32)

    def _edge_arrays(self) -> tuple[Tensor, Tensor, Tensor]:
        if self._arrays is None:
            rows = sorted(
                (*sorted((one, other)), found.there, found.back, found.similarity)
                for one, other, found in self._graph.weighted_edge_list()
            )
            table = torch.tensor(rows, dtype=torch.float64).reshape(-1, 5)
            counts = table[:, :4].long()
            self._arrays = (
                counts[:, :2].contiguous(),
                counts[:, 2:].contiguous(),
                table[:, 4].float(),
            )
        return self._arrays

    def _change(self) -> None:
        self.version += 1
        self._arrays = None
        self._nearby.clear()

    def add_waypoint(self) -> int:
        """Add a waypoint without edges; its number."""
        self._change()
        return int(self._graph.add_node(None))

    def traverse(self, one: int, other: int) -> None:
        """Count a traversal from one waypoint to another; the edge may be new."""
        if one == other:
            return
        if not self._graph.has_edge(one, other):
            self._graph.add_edge(one, other, Evidence())
        evidence = self._graph.get_edge_data(one, other)
        name = "there" if one < other else "back"
        count = getattr(evidence, name) + 1
        setattr(evidence, name, count)
        if count == 1:
            self._change()
        else:  # neither its cost nor its ends changed
            self._arrays = None

    def has_edge(self, one: int, other: int) -> bool:
        return bool(self._graph.has_edge(one, other))

    def link(
        self, one: int, others: Sequence[int], similarities: Sequence[float]
    ) -> None:
        """Join a waypoint with others that it reaches, and store their similarities."""
        for other, similarity in zip(others, similarities, strict=True):
            if other == one:
                continue
            if not self._graph.has_edge(one, other):
                self._graph.add_edge(one, other, Evidence())
            self._graph.get_edge_data(one, other).similarity = similarity
        if len(others):
            self._change()

    def update_similarities(self, similarity: Tensor, least: float) -> int:
        """Give all edges new similarities ``[E]``; drop and count unsupported ones.

        An edge that was never traversed stays if its similarity is above ``least``.
        """
        dropped = []
        ends = self.edges.tolist()
        for (one, other), value in zip(ends, similarity.tolist(), strict=True):
            evidence = self._graph.get_edge_data(one, other)
            evidence.similarity = value
            if not evidence.is_traversed and not value > least:
                dropped.append((one, other))
        self._graph.remove_edges_from(dropped)
        self._change()
        return len(dropped)

    def merge(self, into: Tensor) -> None:
        """Unite waypoints: traversals add up, and the highest similarity stays.

        ``into``, int64 ``[W]``, has the new number of each, 0 to W' - 1.
        """
        number = into.tolist()
        merged: dict[tuple[int, int], Evidence] = {}
        for one, other, found in self._graph.weighted_edge_list():
            low, high = number[min(one, other)], number[max(one, other)]
            if low == high:
                continue
            there, back = found.there, found.back
            if low > high:
                low, high, there, back = high, low, back, there
            evidence = merged.setdefault((low, high), Evidence())
            evidence.there += there
            evidence.back += back
            # NaN is no similarity: any number beats it, and it beats none.
            both = (evidence.similarity, found.similarity)
            evidence.similarity = max(filter(math.isfinite, both), default=math.nan)
        self._replace(max(number, default=-1) + 1, merged)

    def neighbours(self, waypoint: int) -> list[int]:
        return sorted(self._graph.neighbors(waypoint))

    def neighbourhood(self, waypoint: int, hops: int) -> Tensor:
        """Waypoints at most ``hops`` edges away, itself included, in order; ``[A]``."""
        found, front = {waypoint}, {waypoint}
        for _ in range(hops):
            front = {other for one in front for other in self._graph.neighbors(one)}
            front -= found
            found |= front
            if not front:
                break
        return torch.tensor(sorted(found), dtype=torch.int64)

    def nearby(self, waypoint: int, most: int) -> list[int]:
        """Up to ``most`` nearest waypoints by edges, traversed ones first, in order."""
        if (waypoint, most) not in self._nearby:
            found, front = [waypoint], [waypoint]
            seen = {waypoint}
            while front and len(found) < most:
                beside = {
                    other: not evidence.is_traversed
                    for one in front
                    for other, evidence in self._graph.adj(one).items()
                    if other not in seen
                }
                front = sorted(beside, key=lambda other: (beside[other], other))
                seen.update(front)
                found += front
            self._nearby[waypoint, most] = sorted(found[:most])
        return self._nearby[waypoint, most]
