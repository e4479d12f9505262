"""`Blockages`: which edges of a map each agent found closed, and since when."""

from collections import deque

import torch
from torch import Tensor


class Blockages:
    """Edges that agents closed after they failed to get through.

    A *cut* closes several edges at once: the one that failed and those beside it. Cuts
    are opened again together, the oldest first, when they fade or when nothing else is
    left.

    Reference:
        The paper, "Goal reaching process": "find the connections that traverse
        blockages and set their path cost to infinity".

    Args:
        num_agents: number of agents N.
        num_edges: number of edges E of the map.
        fade_after: decisions after which a cut opens by itself; ``None`` for never.

    Raises:
        ValueError: if ``fade_after < 1``.

    Examples:
        >>> blockages = Blockages(1, 3)
        >>> blockages.cut(0, torch.tensor([0, 1]))
        >>> blockages.cut(0, torch.tensor([1, 2]))
        >>> blockages.reopen_oldest(0), blockages.closed.tolist()
        (True, [[False, True, True]])

    Shape notation:
        N: agents.  E: edges.
    """

    #: bool ``[N, E]``.
    closed: Tensor

    def __init__(
        self, num_agents: int, num_edges: int, *, fade_after: int | None = None
    ) -> None:
        if fade_after is not None and fade_after < 1:
            raise ValueError(f"fade_after must be at least 1, got {fade_after}")
        self.fade_after = fade_after
        self.closed = torch.zeros(num_agents, num_edges, dtype=torch.bool)
        self._cuts: list[deque[tuple[int, Tensor]]] = [
            deque() for _ in range(num_agents)
        ]
        self._now = 0

    @property
    def num_cuts(self) -> Tensor:
        """How many cuts of each agent are closed, int64 ``[N]``."""
        return torch.tensor([len(cuts) for cuts in self._cuts])

    def cut(self, agent: int, edges: Tensor) -> None:
        """Close edges of one agent together.

        Args:
            agent: its number.
            edges: int64 ``[K]``, numbers of edges; none is no cut.
        """
        if len(edges):
            self._cuts[agent].append((self._now, edges))
            self.closed[agent, edges] = True

    def reopen_oldest(self, agent: int) -> bool:
        """Open the oldest cut of an agent; edges that a later cut closes stay closed.

        Returns:
            Whether there was one.
        """
        if not self._cuts[agent]:
            return False
        _, edges = self._cuts[agent].popleft()
        self.closed[agent, edges] = False
        for _, later in self._cuts[agent]:
            self.closed[agent, later] = True
        return True

    def clear(self, agents: Tensor) -> None:
        """Open everything for the agents of a mask, bool ``[N]``."""
        self.closed[agents] = False
        for agent in agents.nonzero().flatten().tolist():
            self._cuts[agent].clear()

    def pass_decision(self) -> Tensor:
        """One decision more; cuts that are old enough open.

        Returns:
            bool ``[N]``, the agents whose edges changed.
        """
        self._now += 1
        changed = torch.zeros(len(self._cuts), dtype=torch.bool)
        if self.fade_after is None:
            return changed
        for agent, cuts in enumerate(self._cuts):
            while cuts and self._now - cuts[0][0] >= self.fade_after:
                changed[agent] = self.reopen_oldest(agent)
        return changed
