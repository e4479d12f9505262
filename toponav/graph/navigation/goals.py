"""`GoalNodes`: which waypoints stand for each agent's goal."""

import math

import torch
from torch import Tensor

from toponav.graph.navigation.localiser import Localiser


class GoalNodes:
    """The waypoints most similar to each of N agents' V goal views, as its targets.

    One view is now and then mapped to a wrong place, of several seldom all are. A view
    that passes no waypoint's ``tc_reach`` counts only if the agent's others do not
    either. A waypoint where the agent waits for the goal ``patience`` decisions in vain
    is *dropped* until the episode ends; when all are, the one dropped first comes back.

    Reference:
        The paper, "Goal reaching process": "target localization is performed only once
        at the beginning of an episode".
    """

    def __init__(
        self, num_agents: int, num_views: int, length: int, *, patience: int | None
    ) -> None:
        self.patience = math.inf if patience is None else patience
        shape = (num_agents, num_views)
        #: int64 ``[N, V]``, the waypoint of each view.
        self.nodes = torch.zeros(shape, dtype=torch.int64)
        #: float32 ``[N, V, D]``, of the views.
        self.embeddings = torch.zeros(*shape, length)
        #: bool ``[N, V]``, whether the view is like its waypoint.
        self.counts = torch.zeros(shape, dtype=torch.bool)
        self._waited = torch.zeros(shape, dtype=torch.int64)
        # When each was dropped, counted in drops; 0 for one that was not.
        self._dropped = torch.zeros(shape, dtype=torch.int64)

    @property
    def active(self) -> Tensor:
        """Which of ``nodes`` are targets now, bool ``[N, V]``."""
        return self.counts & (self._dropped == 0)

    def begin(self, agents: Tensor, embedding: Tensor, localiser: Localiser) -> None:
        """Localise the goal views ``[n, V, D]`` of n agents that begin an episode."""
        nodes, similarity = localiser.nearest(embedding.flatten(0, 1))
        similarity = similarity.reshape(embedding.shape[:2])
        passes = similarity > localiser.rules.tc_reach
        most = similarity == similarity.max(1, keepdim=True).values
        counts = torch.where(passes.any(1, keepdim=True), passes, most)
        self.put(agents, embedding, nodes.reshape(embedding.shape[:2]), counts)

    def put(
        self, agents: Tensor, embedding: Tensor, nodes: Tensor, counts: Tensor
    ) -> None:
        """Take waypoints ``[n, V]`` for goal views ``[n, V, D]``, and which count."""
        self.nodes[agents] = nodes
        self.embeddings[agents] = embedding.cpu()
        self.counts[agents] = counts
        self._waited[agents] = 0
        self._dropped[agents] = 0

    def wait(self, place: Tensor) -> Tensor:
        """Count decisions at goals, drop those in vain; whose targets changed."""
        here = self._are_at(place)
        self._waited += here
        late = here & (self._waited >= self.patience)
        if late.any():
            self._dropped[late] = self._dropped.max() + 1
            self._waited[late] = 0
            empty = ~self.active.any(1)
            first = self._dropped.masked_fill(~self.counts, self._dropped.max() + 1)
            is_first = first == first.min(1, keepdim=True).values
            self._dropped[empty.unsqueeze(1) & is_first] = 0
        return late.any(1)

    def restart(self, agents: Tensor) -> None:
        """The agents of a mask, bool ``[N]``, have not waited at their goals yet."""
        self._waited[agents] = 0

    def view_at(self, place: Tensor) -> Tensor:
        """The goal view of each agent that is at its goal, ``[N, D]``."""
        at = self._are_at(place).int().argmax(1)
        return self.embeddings[torch.arange(len(at)), at]

    def _are_at(self, place: Tensor) -> Tensor:
        return self.active & (self.nodes == place.unsqueeze(1))
