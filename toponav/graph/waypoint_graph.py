"""`WaypointGraph`: which waypoints are neighbours, and what speaks for each edge."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import rustworkx
import torch
from torch import Tensor


@dataclass
class Evidence:
    """What speaks for an edge.

    Args:
        there: how often an observation was mapped to its lower waypoint and the next
            one to the other.
        back: the same the other way round.
        similarity: of its ends when it was last judged, NaN if it never was.
    """

    there: int = 0
    back: int = 0
    similarity: float = math.nan

    @property
    def walked(self) -> bool:
        """Whether it was ever walked, this way or that."""
        return self.there + self.back > 0


class WaypointGraph:
    """Edges between waypoints 0 to W - 1, kept by rustworkx.

    Two waypoints are neighbours or not, but each edge knows in which direction it was
    walked: who walked from one view to another seldom knows how to walk back, since
    that is backwards, looking the same way.

    Args:
        unwalked_cost: cost of an edge in a direction in which it was never walked, in
            edges that were.

    Raises:
        ValueError: if ``unwalked_cost`` is below 1.

    Examples:
        >>> graph = WaypointGraph(unwalked_cost=3.0)
        >>> nodes = [graph.add_waypoint() for _ in range(4)]
        >>> graph.see(0, [1], [0.9])
        >>> graph.walk(2, 1)
        >>> graph.edges, graph.edge_cost
        (tensor([[0, 1],
                [1, 2]]), tensor([[3., 3.],
                [3., 1.]]))
        >>> graph.neighbourhood(0, 1), graph.neighbourhood(0, 5)
        (tensor([0, 1]), tensor([0, 1, 2]))
        >>> graph.nearby(1, 2)
        [1, 2]

    Shape notation:
        W: waypoints.  E: edges.
    """

    def __init__(self, *, unwalked_cost: float = 3.0) -> None:
        if not unwalked_cost >= 1:
            raise ValueError(f"unwalked_cost must be at least 1, got {unwalked_cost}")
        self.unwalked_cost = unwalked_cost
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
        version: int | None = None,
    ) -> None:
        """Become the graph of these waypoints and edges.

        Args:
            num_waypoints: W.
            edges: int64 ``[E, 2]``, each pair once.
            traversals: int64 ``[E, 2]``, there and back, see `Evidence`.
            similarity: float32 ``[E]``, see `Evidence`.
            version: of the graph from now on; one more by default.

        Raises:
            ValueError: if an edge names no waypoint.
        """
        if edges.numel() and not 0 <= int(edges.min()) <= int(edges.max()) < (
            num_waypoints
        ):
            raise ValueError(
                f"edges must join waypoints 0 to {num_waypoints - 1}, got "
                f"{int(edges.min())} to {int(edges.max())}"
            )
        self._graph = rustworkx.PyGraph(multigraph=False)
        self._graph.add_nodes_from([None] * num_waypoints)
        told = zip(
            edges.tolist(), traversals.tolist(), similarity.tolist(), strict=True
        )
        for (one, other), (there, back), value in told:
            if one > other:
                there, back = back, there
            self._graph.add_edge(one, other, Evidence(there, back, value))
        self._change()
        self.version = self.version if version is None else version

    @property
    def num_waypoints(self) -> int:
        """W."""
        return int(self._graph.num_nodes())

    @property
    def edges(self) -> Tensor:
        """Each edge once, the lower waypoint first, in order; int64 ``[E, 2]``."""
        return self._told()[0]

    @property
    def traversals(self) -> Tensor:
        """How often each edge was walked, there and back, int64 ``[E, 2]``."""
        return self._told()[1]

    @property
    def edge_similarity(self) -> Tensor:
        """Similarity of each edge's ends, NaN if never judged, float32 ``[E]``."""
        return self._told()[2]

    @property
    def edge_cost(self) -> Tensor:
        """1 for a direction that was walked, else ``unwalked_cost``.

        float32 ``[E, 2]``: from the lower waypoint to the other, and back.
        """
        walked = self.traversals > 0
        return torch.where(walked, 1.0, self.unwalked_cost).to(torch.float32)

    def _told(self) -> tuple[Tensor, Tensor, Tensor]:
        """Edges, traversals and similarities, made anew after a change."""
        if self._arrays is None:
            found = sorted(
                (*sorted((one, other)), told.there, told.back, told.similarity)
                for one, other, told in self._graph.weighted_edge_list()
            )
            rows = list(zip(*found, strict=True)) or [(), (), (), (), ()]
            ends = torch.tensor(rows[:2], dtype=torch.int64).reshape(2, -1).T
            self._arrays = (
                ends.contiguous(),
                torch.tensor(rows[2:4], dtype=torch.int64)
                .reshape(2, -1)
                .T.contiguous(),
                torch.tensor(rows[4], dtype=torch.float32),
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

    def walk(self, one: int, other: int) -> None:
        """Count a traversal from one waypoint to another; the edge may be new."""
        if one == other:
            return
        if not self._graph.has_edge(one, other):
            self._graph.add_edge(one, other, Evidence())
        told = self._graph.get_edge_data(one, other)
        if one < other:
            told.there += 1
        else:
            told.back += 1
        if (told.there if one < other else told.back) == 1:
            self._change()
        else:  # neither its cost nor its ends changed
            self._arrays = None

    def has_edge(self, one: int, other: int) -> bool:
        """Whether two waypoints are neighbours."""
        return bool(self._graph.has_edge(one, other))

    def see(
        self, one: int, others: Sequence[int], similarities: Sequence[float]
    ) -> None:
        """Link a waypoint with others that it can see, or note how alike they are.

        Args:
            one: the waypoint.
            others: its neighbours from now on.
            similarities: to each of them.
        """
        for other, similarity in zip(others, similarities, strict=True):
            if other == one:
                continue
            if self._graph.has_edge(one, other):
                self._graph.get_edge_data(one, other).similarity = similarity
            else:
                self._graph.add_edge(one, other, Evidence(similarity=similarity))
        if len(others):
            self._change()

    def judge(self, similarity: Tensor, least: float) -> int:
        """Give all edges new similarities and drop those that nothing speaks for.

        Args:
            similarity: float ``[E]``, in the order of ``edges``.
            least: an edge that was never walked stays if it is above this.

        Returns:
            The number of edges dropped.
        """
        dropped = []
        told = zip(self.edges.tolist(), similarity.tolist(), strict=True)
        for (one, other), value in told:
            evidence = self._graph.get_edge_data(one, other)
            evidence.similarity = value
            if not evidence.walked and not value > least:
                dropped.append((one, other))
        self._graph.remove_edges_from(dropped)
        self._change()
        return len(dropped)

    def merge(self, into: Tensor) -> None:
        """Make some waypoints one.

        Traversals add up, and of several similarities the highest stays.

        Args:
            into: int64 ``[W]``, the new number of each waypoint, 0 to W' - 1.
        """
        ends = into[self.edges]
        columns = (ends.tolist(), self.traversals.tolist())
        merged: dict[tuple[int, int], Evidence] = {}
        for (one, other), (there, back), value in zip(
            *columns, self.edge_similarity.tolist(), strict=True
        ):
            if one == other:
                continue
            if one > other:
                one, other, there, back = other, one, back, there
            told = merged.setdefault((one, other), Evidence())
            told.there += there
            told.back += back
            # NaN is no similarity: any number beats it, and it beats none.
            if math.isnan(told.similarity) or value > told.similarity:
                told.similarity = value
        pairs = sorted(merged)
        counts = [(merged[pair].there, merged[pair].back) for pair in pairs]
        self.restore(
            int(into.max()) + 1 if len(into) else 0,
            torch.tensor(pairs, dtype=torch.int64).reshape(-1, 2),
            torch.tensor(counts, dtype=torch.int64).reshape(-1, 2),
            torch.tensor([merged[pair].similarity for pair in pairs]),
        )

    def neighbours(self, waypoint: int) -> list[int]:
        """Waypoints one edge away, in order."""
        return sorted(self._graph.neighbors(waypoint))

    def neighbourhood(self, waypoint: int, hops: int) -> Tensor:
        """Waypoints at most so many edges away, itself included.

        Args:
            waypoint: its number.
            hops: 0 or more.

        Returns:
            int64 ``[A]``, in order.
        """
        found, front = {waypoint}, [waypoint]
        for _ in range(hops):
            beside = {other for one in front for other in self._graph.neighbors(one)}
            front = list(beside - found)
            found |= beside
            if not front:
                break
        return torch.tensor(sorted(found), dtype=torch.int64)

    def nearby(self, waypoint: int, most: int) -> list[int]:
        """The nearest waypoints by edges, walked ones first, itself included.

        Args:
            waypoint: its number.
            most: how many at most.

        Returns:
            Up to ``most`` numbers, in order.
        """
        if (waypoint, most) not in self._nearby:
            found, front = [waypoint], [waypoint]
            seen = {waypoint}
            while front and len(found) < most:
                beside = {
                    other: not evidence.walked
                    for one in front
                    for other, evidence in self._graph.adj(one).items()
                    if other not in seen
                }
                front = sorted(beside, key=lambda other: (beside[other], other))
                seen.update(front)
                found += front
            self._nearby[waypoint, most] = sorted(found[:most])
        return self._nearby[waypoint, most]

    def components(self) -> list[set[int]]:
        """Sets of waypoints that paths join, the largest first."""
        found = rustworkx.connected_components(self._graph)
        return sorted(found, key=lambda some: (-len(some), min(some)))
