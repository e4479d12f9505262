"""`Progress`: whether each agent comes nearer to its goal."""

import torch
from torch import Tensor

#: Of the costs in a window, how many may be lower than the level that was reached: one
#: in so many. Some places are mistaken, and few mistakes must not count.
_MISTAKEN = 8
# A cut follows soon on another within so many times the patience.
_SOON = 2


class Progress:
    """Watches what is left of each agent's way over its last decisions.

    An agent is *stuck* once the second half of its last ``patience`` decisions brought
    it no nearer to the goal than the first half, by the median of what was left of its
    way. Medians, since an agent mistakes its place now and then. It is not asked which
    edge was tried: an agent before a closed corridor stands at many waypoints in turn,
    and walks in circles besides.

    Most agents that are stuck only fail to turn a corner, for which it is enough to
    give up one edge. The *reach* of a cut therefore grows with each that follows soon
    on another: 0, 1, 3, 7 and so on edges around the place.

    Reference:
        The paper, "Goal reaching process": "if the goal is not reached within a certain
        number of time steps". Counted anew from each plan, since the whole way to a
        goal takes longer than it takes to be sure of one blockage.

    Args:
        patience: decisions; ``None`` if nobody is ever stuck.

    Raises:
        ValueError: if ``patience < 2``.

    Examples:
        >>> progress = Progress(patience=4)
        >>> progress.resize(1)
        >>> left = torch.tensor([[9.0], [8], [8], [9]])
        >>> place = torch.tensor([4])
        >>> [progress.watch(place, cost).item() for cost in left]
        [False, False, False, True]
        >>> progress.give_up(0)
        (4, 8.0, 0)

    Shape notation:
        N: agents.
    """

    def __init__(self, *, patience: int | None = 40) -> None:
        if patience is not None and patience < 2:
            raise ValueError(f"patience must be at least 2, got {patience}")
        self.patience = patience
        self.resize(0)

    def resize(self, num_agents: int) -> None:
        """Begin with N agents that have not walked yet."""
        length = self.patience or 1
        # The last decisions with a way to the goal, the newest last.
        self._left = torch.zeros(num_agents, length, dtype=torch.float64)
        self._place = torch.full((num_agents, length), -1)
        self._count = torch.zeros(num_agents, dtype=torch.int64)
        # Reach of the next cut, if it follows on the last one.
        self._reach = torch.zeros(num_agents, dtype=torch.int64)
        self._since_cut = torch.zeros(num_agents, dtype=torch.int64)

    def restart(self, agents: Tensor) -> None:
        """Watch the agents of a mask, bool ``[N]``, anew: their way is another one."""
        self._count[agents] = 0

    def forget(self, agents: Tensor) -> None:
        """These agents, bool ``[N]``, have been put elsewhere."""
        self.restart(agents)
        self._reach[agents] = 0

    def watch(self, place: Tensor, left: Tensor) -> Tensor:
        """Look at one decision.

        Args:
            place: int64 ``[N]``, where each agent is, -1 if lost.
            left: float64 ``[N]``, the cost of what is left of its way; a decision
                without a way, or at the goal's waypoint, does not count.

        Returns:
            bool ``[N]``, who is stuck.
        """
        if self.patience is None:
            return torch.zeros(len(place), dtype=torch.bool)
        walks = (place >= 0) & left.isfinite() & (left > 0)
        row = walks.nonzero().squeeze(1)
        for kept, new in ((self._left, left.double()), (self._place, place)):
            kept[row] = torch.cat([kept[row, 1:], new[row].unsqueeze(1)], 1)
        self._count[row] += 1
        self._since_cut[row] += 1
        self._reach[self._since_cut > _SOON * self.patience] = 0
        half = self.patience // 2
        before = self._left[:, :half].median(1).values
        since = self._left[:, -half:].median(1).values
        return walks & (self._count >= self.patience) & (since >= before)

    def give_up(self, agent: int) -> tuple[int, float, int]:
        """What an agent that is stuck gives up; it is watched anew.

        Returns:
            The waypoint where it came nearest to its goal, the cost of what was left
            there, and the reach of the cut in edges. One in eight of the last
            decisions may have been at a lower cost.
        """
        number = self._left.shape[1] // _MISTAKEN + 1
        found = self._left[agent].kthvalue(number)
        reach = int(self._reach[agent])
        self._reach[agent] = 2 * reach + 1
        self._since_cut[agent] = self._count[agent] = 0
        return int(self._place[agent, found.indices]), float(found.values), reach
