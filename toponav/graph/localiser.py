"""`Localiser`: at which waypoint of a map each agent is."""

from typing import Protocol

import torch
from torch import Tensor

from toponav.graph.waypoints import Compare

# Comparisons of one call at most, so that a large map needs little memory.
_AT_ONCE = 1 << 16


class Map(Protocol):
    """What localising, planning and navigating read of a map.

    `TopologicalMap` has it all.

    Shape notation:
        W: waypoints.  E: edges.  D: embedding.  P: prepared entry.
    """

    @property
    def num_waypoints(self) -> int:
        """Number of waypoints W."""

    @property
    def embeddings(self) -> Tensor:
        """Of the waypoints' views, float32 ``[W, D]``."""

    @property
    def prepared(self) -> Tensor:
        """What a comparison needs of each waypoint, ``[W, P]``."""

    @property
    def edges(self) -> Tensor:
        """The edges, undirected, each once, int64 ``[E, 2]``."""

    @property
    def edge_cost(self) -> Tensor:
        """Cost of each edge, finite and above 0.

        float32 ``[E, 2]``, from the first end to the second and back, or ``[E]``, the
        same both ways.
        """

    @property
    def version(self) -> int:
        """Changes with waypoints and edges."""

    def neighbourhood(self, node: int, hops: int) -> Tensor:
        """Waypoints at most ``hops`` edges away, int64 ``[K]``."""


class Localiser:
    """Maps each agent's view to the waypoint that is most like it.

    First along the path that it walks, if it walks one; if no waypoint there is like
    the view, among those at most ``hops`` edges away from its last place; then among
    all; if none is, the agent is lost and keeps no place. Looking near the last place
    first is both cheaper and surer, since other parts of the maze may look alike.
    Looking along the path keeps an agent on one way: many walks have left waypoints at
    the same spot, and from each of them another way leads on.

    Reference:
        The paper, Fig. 10. The path first, and similarities that are averaged over the
        last views: Savinov et al., "Semi-parametric topological memory for navigation"
        (2018), https://arxiv.org/abs/1803.00653

    Args:
        map: see `Map`.
        compare: embeddings ``[N, D]`` and prepared waypoints ``[N, M, P]`` to
            similarities ``[N, M]`` in [0, 1].
        tc_reach: a view is at a waypoint if its similarity is above it; in [0, 1).
        hops: how far from the last place to look first.
        window: number of last views whose similarities are averaged; 1 takes the
            present one alone.
        shortlist: waypoints that are compared, those whose embeddings are nearest to
            the view's by straight distance, which is far cheaper; ``None`` for all.
        stay_above: an agent stays at its last place while the similarity to it is above
            this; ``None`` lets it change to any that is more alike.

    Raises:
        ValueError: if an argument is out of range or the map is empty.

    Examples:
        See `Navigator`.

    Shape notation:
        N: agents.  D: embedding.  M: candidates.  W: waypoints.  P: prepared entry.
    """

    #: int64 ``[N]``; the last place of each agent, -1 without one.
    place: Tensor

    def __init__(
        self,
        map: Map,
        compare: Compare,
        *,
        tc_reach: float,
        hops: int = 7,
        window: int = 1,
        shortlist: int | None = None,
        stay_above: float | None = None,
    ) -> None:
        if not 0 <= tc_reach < 1:
            raise ValueError(f"tc_reach must be in [0, 1), got {tc_reach}")
        for name, number in (("hops", hops), ("window", window)):
            if number < 1:
                raise ValueError(f"{name} must be at least 1, got {number}")
        if shortlist is not None and shortlist < 1:
            raise ValueError(f"shortlist must be None or at least 1, got {shortlist}")
        if not map.num_waypoints:
            raise ValueError("the map must have a waypoint to be at, got an empty map")
        self.map = map
        self.compare = compare
        self.tc_reach = tc_reach
        self.hops = hops
        self.window = window
        self.shortlist = shortlist
        self.stay_above = stay_above
        self.resize(0)

    def resize(self, num_agents: int) -> None:
        """Begin with N agents that have no place, and with the map as it is now."""
        self._near: dict[int, Tensor] = {}
        self.place = torch.full((num_agents,), -1)
        # The last views of each agent, newest first, and how many of them count.
        size = (num_agents, self.window, self.map.embeddings.shape[1])
        self._views = torch.zeros(size)
        self._square = self.map.embeddings.float().square().sum(1).cpu()
        self._count = torch.zeros(num_agents, dtype=torch.int64)

    def forget(self, agents: Tensor) -> None:
        """Forget place and last views of the agents of a mask, bool ``[N]``."""
        self.place[agents] = -1
        self._count[agents] = 0

    def locate(self, embedding: Tensor, path: Tensor | None = None) -> Tensor:
        """The place of each agent, int64 ``[N]``, -1 for those that are lost.

        Args:
            embedding: float32 ``[N, D]``, of the present views.
            path: int64 ``[N, L]``, waypoints that each agent walks to one after the
                other, -1 for an agent without a path; ``None`` if nobody has one.
        """
        if self._views.device != embedding.device:
            self._views = self._views.to(embedding.device)
        self._views = torch.cat([embedding.unsqueeze(1), self._views[:, :-1]], 1)
        self._count = (self._count + 1).clamp(max=self.window)
        found = torch.full_like(self.place, -1)
        if path is not None:
            walking = ((self.place >= 0) & (path >= 0).all(1)).nonzero().flatten()
            ahead = torch.cat([self.place.unsqueeze(1), path], 1)
            if len(walking):
                found[walking] = self._best(walking, ahead[walking])
        known = ((self.place >= 0) & (found < 0)).nonzero().flatten()
        if len(known):
            found[known] = self._near_last(known)
        unknown = (found < 0).nonzero().flatten()
        if len(unknown):
            found[unknown] = self._anywhere(unknown)
        self.place = found
        return found.clone()

    def _near_last(self, agents: Tensor) -> Tensor:
        last = self.place[agents].tolist()
        nodes = torch.nn.utils.rnn.pad_sequence(
            [self.around(node) for node in last], batch_first=True, padding_value=-1
        )
        return self._best(agents, self._short(self._views[agents, 0], nodes))

    def _best(self, agents: Tensor, nodes: Tensor) -> Tensor:
        """The most similar of some waypoints, -1 if none is similar enough.

        Args:
            agents: int64 ``[n]``.
            nodes: int64 ``[n, M]``, -1 for none; the first one is the last place.
        """
        score = self._scores(agents, nodes.clamp(min=0)).masked_fill(nodes < 0, -1.0)
        best, at = score.max(1)
        found = nodes.gather(1, at.unsqueeze(1)).squeeze(1)
        if self.stay_above is not None:
            found = torch.where(score[:, 0] > self.stay_above, nodes[:, 0], found)
        return found.masked_fill(best <= self.tc_reach, -1)

    def _anywhere(self, agents: Tensor) -> Tensor:
        found = []
        for some in agents.split(max(_AT_ONCE // self.map.num_waypoints, 1)):
            nodes = self._every(self._views[some, 0])
            best, at = self._scores(some, nodes).max(1)
            place = nodes.gather(1, at.unsqueeze(1)).squeeze(1)
            found.append(place.masked_fill(best <= self.tc_reach, -1))
        return torch.cat(found)

    def _every(self, embedding: Tensor) -> Tensor:
        """The waypoints of the whole map to compare with views ``[n, D]``."""
        every = torch.arange(self.map.num_waypoints)
        return self._short(embedding, every.expand(len(embedding), -1))

    def _short(self, embedding: Tensor, nodes: Tensor) -> Tensor:
        """Of waypoints ``[n, M]``, -1 for none, those whose embeddings are nearest.

        The first one stays the first: it is where the agent was.
        """
        if self.shortlist is None or nodes.shape[1] <= self.shortlist:
            return nodes
        view, every = embedding.float().cpu(), self.map.embeddings.float().cpu()
        # |w - v|^2 but for |v|^2, which is the same for all.
        away = self._square - 2 * view @ every.T
        away = away.gather(1, nodes.clamp(min=0)).masked_fill(nodes < 0, torch.inf)
        away[:, 0] = -torch.inf
        at = away.topk(self.shortlist, largest=False).indices.sort(1).values
        return nodes.gather(1, at)

    def nearest(self, embedding: Tensor) -> tuple[Tensor, Tensor]:
        """The waypoint most like each view, and how alike they are.

        Args:
            embedding: ``[n, D]``.

        Returns:
            int64 ``[n]`` and float32 ``[n]``.
        """
        places, values = [], []
        for some in embedding.split(max(_AT_ONCE // self.map.num_waypoints, 1)):
            nodes = self._every(some)
            best, at = self.similarity(some, nodes).max(1)
            places.append(nodes.gather(1, at.unsqueeze(1)).squeeze(1))
            values.append(best)
        return torch.cat(places), torch.cat(values)

    def _scores(self, agents: Tensor, nodes: Tensor) -> Tensor:
        """Similarity of the last views of some agents to ``nodes``, ``[n, M]``."""
        total = torch.zeros(nodes.shape)
        for age in range(self.window):
            counts = self._count[agents] > age
            if not counts.any():
                break
            views = self._views[agents, age]
            total += self.similarity(views, nodes) * counts.unsqueeze(1)
        return total / self._count[agents].unsqueeze(1)

    def similarity(self, embedding: Tensor, nodes: Tensor) -> Tensor:
        """Similarity of views to waypoints, on the CPU.

        Args:
            embedding: ``[n, D]``.
            nodes: int64 ``[n, M]``.

        Returns:
            float32 ``[n, M]``.
        """
        prepared = self.map.prepared.to(embedding.device)[nodes.to(embedding.device)]
        return self.compare(embedding, prepared).float().cpu()

    def around(self, node: int) -> Tensor:
        """A waypoint, and then those at most ``hops`` edges away from it, ``[K]``."""
        if node not in self._near:
            near = self.map.neighbourhood(node, self.hops).cpu()
            first = torch.tensor([node])
            self._near[node] = torch.cat([first, near[near != node]])
        return self._near[node]
