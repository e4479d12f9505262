"""`Localiser`: at which waypoint of a map each agent is."""

from typing import Protocol

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from toponav.graph.rules import NavigatorRules
from toponav.graph.waypoints import Compare
from toponav.parts import require_parts, require_returned

# Comparisons of one call at most, so that a large map needs little memory.
_AT_ONCE = 1 << 16


class Map(Protocol):
    """What navigation reads of a map, such as `TopologicalMap`."""

    @property
    def num_waypoints(self) -> int: ...
    @property
    def embeddings(self) -> Tensor: ...  # of the waypoints' views, float32 [W, D]
    @property
    def prepared(self) -> Tensor: ...  # what a comparison needs of each, [W, P]
    @property
    def edges(self) -> Tensor: ...  # undirected, each once, int64 [E, 2]
    @property
    def edge_cost(self) -> Tensor: ...  # above 0, [E, 2], there and back, or [E]
    @property
    def version(self) -> int: ...  # changes with waypoints and edges


class Localiser:
    """Maps the view of each of N agents to the waypoint that is most similar to it.

    First along the path that it walks, which keeps it on one route; if no waypoint
    there passes ``tc_reach``, among those at most ``hops`` edges away from its last
    place, since other parts of the maze may look alike; then among all; if none passes,
    the agent is lost.

    Reference:
        The paper, Fig. 10. The path first: Savinov et al., "Semi-parametric topological
        memory for navigation" (2018), https://arxiv.org/abs/1803.00653
    """

    def __init__(
        self, map: Map, compare: Compare, rules: NavigatorRules, num_agents: int = 0
    ) -> None:
        wanted = "num_waypoints", "embeddings", "prepared", "edges", "edge_cost"
        require_parts(map, "map", "a TopologicalMap", *wanted, "version")
        if not map.num_waypoints:
            raise ValueError("the map must have a waypoint to be at, got an empty map")
        self.map = map
        self.compare = compare
        self.rules = rules
        #: int64 ``[N]``, the last place of each agent, -1 without one.
        self.place = torch.full((num_agents,), -1)
        ends = map.edges.cpu().numpy()
        entries = (np.ones(len(ends)), (ends[:, 0], ends[:, 1]))
        self._graph = csr_array(entries, shape=(map.num_waypoints,) * 2)
        self._near: dict[int, Tensor] = {}
        self._square = map.embeddings.float().square().sum(1).cpu()

    def locate(self, embedding: Tensor, path: Tensor | None = None) -> Tensor:
        """The place of each agent by its view ``[N, D]``, -1 for those that are lost.

        ``path`` has the next waypoints of each, int64 ``[N, L]``, -1 without a path.
        """
        found = torch.full_like(self.place, -1)
        if path is not None:
            walking = ((self.place >= 0) & (path >= 0).all(1)).nonzero().flatten()
            ahead = torch.cat([self.place.unsqueeze(1), path], 1)
            if len(walking):
                found[walking] = self._best(embedding[walking], ahead[walking])
        known = ((self.place >= 0) & (found < 0)).nonzero().flatten()
        if len(known):
            near = [self._around(node) for node in self.place[known].tolist()]
            around = pad_sequence(near, batch_first=True, padding_value=-1)
            views = embedding[known]
            found[known] = self._best(views, self._shorten(views, around))
        unknown = (found < 0).nonzero().flatten()
        if len(unknown):
            nearest, similarity = self.nearest(embedding[unknown])
            found[unknown] = nearest.masked_fill(similarity <= self.rules.tc_reach, -1)
        self.place = found
        return found.clone()

    def _best(self, embedding: Tensor, nodes: Tensor) -> Tensor:
        scores = self.similarity(embedding, nodes.clamp(min=0))
        best, at = scores.masked_fill(nodes < 0, -1.0).max(1)
        found = nodes.gather(1, at.unsqueeze(1)).squeeze(1)
        return found.masked_fill(best <= self.rules.tc_reach, -1)

    def _shorten(self, embedding: Tensor, nodes: Tensor) -> Tensor:
        """Of waypoints ``[n, M]`` the first and those with the nearest embeddings."""
        shortlist = self.rules.shortlist
        if shortlist is None or nodes.shape[1] <= shortlist:
            return nodes
        view, every = embedding.float().cpu(), self.map.embeddings.float().cpu()
        # |w - v|^2 but for |v|^2, which is the same for all.
        distance = self._square - 2 * view @ every.T
        distance = distance.gather(1, nodes.clamp(min=0))
        distance = distance.masked_fill(nodes < 0, torch.inf)
        distance[:, 0] = -torch.inf
        at = distance.topk(shortlist, largest=False).indices.sort(1).values
        return nodes.gather(1, at)

    def nearest(self, embedding: Tensor) -> tuple[Tensor, Tensor]:
        """The most similar waypoint of all to views ``[n, D]``, and its similarity."""
        every = torch.arange(self.map.num_waypoints)
        places, values = [], []
        for views in embedding.split(max(_AT_ONCE // len(every), 1)):
            nodes = self._shorten(views, every.expand(len(views), -1))
            best, at = self.similarity(views, nodes).max(1)
            places.append(nodes.gather(1, at.unsqueeze(1)).squeeze(1))
            values.append(best)
        return torch.cat(places), torch.cat(values)

    def similarity(self, embedding: Tensor, nodes: Tensor) -> Tensor:
        """Similarity of views ``[n, D]`` to waypoints ``[n, M]``, on the CPU."""
        prepared = self.map.prepared.to(embedding.device)[nodes.to(embedding.device)]
        found = self.compare(embedding, prepared)
        require_returned("compare", found, N=nodes.shape[0], M=nodes.shape[1])
        return found.float().cpu()

    def _around(self, node: int) -> Tensor:
        """The waypoint and those at most ``hops`` edges away, int64 ``[M]``."""
        if node not in self._near:
            hops = self.rules.hops
            steps = dijkstra(
                self._graph, directed=False, indices=node, unweighted=True, limit=hops
            )
            near = torch.from_numpy(np.isfinite(steps)).nonzero().flatten()
            self._near[node] = torch.cat([torch.tensor([node]), near[near != node]])
        return self._near[node]
