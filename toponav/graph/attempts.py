"""`Attempts`: how long each agent has tried each edge without getting on."""

import torch
from torch import Tensor


class Attempts:
    """Counts the decisions that agents spend on the first edge of their path.

    An edge is *stuck* once ``patience`` decisions were spent on it since the agent
    last *got on*, that is, came nearer to its goal than ever since the last plan, by
    the cost of the path that is left. An agent that is driven off and comes back goes
    on counting where it was; one that sways between two places counts for both. An
    edge that was walked to its end is none that is stuck, and is counted anew. An edge
    is stuck too once the agent set off on it ``tries`` times and came to a place no
    nearer to its goal, as when it walks in circles past the start of an edge that
    exists on the map alone.

    Reference:
        The paper, "Goal reaching process": "if the goal is not reached within a certain
        number of time steps". Counted per edge, since the whole way to a goal takes
        longer than it takes to be sure of one blockage.

    Args:
        patience: decisions; ``None`` if no edge is ever stuck.
        tries: times; ``None`` if decisions alone count.

    Raises:
        ValueError: if ``patience < 1`` or ``tries < 1``.

    Examples:
        >>> attempts = Attempts(patience=2)
        >>> attempts.resize(1)
        >>> place, onward, cost = torch.tensor([4]), torch.tensor([7]), torch.ones(1)
        >>> [attempts.count(place, onward, cost).item() for _ in range(3)]
        [False, False, True]

    Shape notation:
        N: agents.
    """

    def __init__(self, *, patience: int | None = 40, tries: int | None = None) -> None:
        for name, number in (("patience", patience), ("tries", tries)):
            if number is not None and number < 1:
                raise ValueError(f"{name} must be at least 1, got {number}")
        self.patience = patience
        self.tries = tries
        self.resize(0)

    def resize(self, num_agents: int) -> None:
        """Begin with N agents that have tried nothing."""
        self._least = torch.full((num_agents,), torch.inf, dtype=torch.float64)
        self._spent: list[dict[tuple[int, int], int]] = [{} for _ in range(num_agents)]
        self._cost = torch.full((num_agents,), torch.inf, dtype=torch.float64)
        # How often each agent left an edge for a place no nearer to its goal.
        self._failed: list[dict[tuple[int, int], int]] = [{} for _ in range(num_agents)]
        # The edge that each agent tried last, and what was left of its way then.
        self._tried: list[tuple[int, int]] = [(-1, -1)] * num_agents

    def restart(self, agents: Tensor) -> None:
        """Forget everything of the agents of a mask, bool ``[N]``."""
        self._least[agents] = torch.inf
        for agent in agents.nonzero().flatten().tolist():
            self._spent[agent].clear()
            self._failed[agent].clear()
            self._tried[agent] = (-1, -1)

    def replan(self, agent: int, cost: float) -> None:
        """Measure getting on from a new plan; what was spent on edges stays.

        Args:
            agent: its number.
            cost: of the new path from where it is.
        """
        self._least[agent] = cost

    def count(self, place: Tensor, onward: Tensor, cost: Tensor) -> Tensor:
        """Count one decision.

        Args:
            place: int64 ``[N]``, where each agent is, -1 if lost.
            onward: int64 ``[N]``, the next waypoint of its path.
            cost: ``[N]``, of the path that is left.

        Returns:
            bool ``[N]``, whose first edge is stuck; its count begins anew.
        """
        stuck = torch.zeros(len(place), dtype=torch.bool)
        if self.patience is None:
            return stuck
        has_way = (place >= 0) & (onward != place) & cost.isfinite()
        gets_on = has_way & (cost < self._least)
        for agent in gets_on.nonzero().flatten().tolist():
            self._spent[agent].clear()
        self._least = torch.where(gets_on, cost.double(), self._least)
        for agent in has_way.nonzero().flatten().tolist():
            here, spent = int(place[agent]), self._spent[agent]
            tried = self._tried[agent]
            if tried[1] == here:
                spent.pop(tried, None)
                self._failed[agent].pop(tried, None)
            elif tried[0] not in (here, -1) and cost[agent] >= self._cost[agent]:
                failed = self._failed[agent]
                failed[tried] = failed.get(tried, 0) + 1
            self._cost[agent] = cost[agent]
            edge = self._tried[agent] = (here, int(onward[agent]))
            if not gets_on[agent]:
                spent[edge] = spent.get(edge, 0) + 1
            if self._is_stuck(agent, edge):
                stuck[agent] = True
                spent.pop(edge, None)
                self._failed[agent].pop(edge, None)
        return stuck

    def _is_stuck(self, agent: int, edge: tuple[int, int]) -> bool:
        assert self.patience is not None
        too_long = self._spent[agent].get(edge, 0) >= self.patience
        failed = self._failed[agent].get(edge, 0)
        return too_long or (self.tries is not None and failed >= self.tries)
