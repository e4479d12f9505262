"""`GoalSearch`: where to look for goals that are a little beside where they seem."""

from dataclasses import dataclass

import torch
from torch import Tensor

#: Points where a goal may be, of each agent; of these the last ones are drawn around
#: where it was paid. How near to each other they count as one, in steps.
_POINTS, _PAID, _ALIKE = 128, 32, 0.8
#: Of the first ones, those that are drawn so many times as far away.
_FAR, _FARTHER = 24, 2.5
#: Decisions on the way to a point that leave 1 / e of what it is worth; steps from which
#: an agent is there, and decisions after which it looks somewhere else although it is
#: not: walls may be between.
_WAY, _THERE, _PATIENCE = 6.0, 0.7, 16
#: Steps from where it was last that count as a move, and from where it is, or tried to
#: get, to where it looks next, at least.
_MOVED, _ELSEWHERE = 0.4, 1.2
#: What is left of a point where the agent has been without being paid, and of one that
#: it aimed at. Once no more than a share of all is left, it begins again.
_PASSED, _TRIED, _BEGIN_AGAIN = 0.5, 0.2, 0.3
#: What a time that it was paid counts beside what its views say.
_VOTE = 6.0


@dataclass(frozen=True, kw_only=True)
class SearchRules:
    """Where goals are looked for. Lengths are in steps."""

    #: Standard deviation of the distance from where a goal's views agree to the goal.
    search: float = 0.8
    #: Deviation of the distance from where the agent was paid to the goal.
    reach: float = 1.0

    def __post_init__(self) -> None:
        for name in ("search", "reach"):
            if (value := getattr(self, name)) <= 0:
                raise ValueError(f"{name} must be above 0, got {value}")


class GoalSearch:
    """Points where the goals of N agents may be, and how likely each of them is.

    They are drawn once, when an episode begins, around where the goal's views agree
    that it is. Where an agent was paid for its goal, the goal is nearby: that counts
    until the episode ends. An agent that is looking walks to one point after the other,
    and keeps to each until it is there or has tried for long. Points that it passed
    without being paid count less until it starts again somewhere else.

    Reference:
        Beyond the paper. Search by the likelihood of what was not found: Koopman,
        "Search and Screening" (1946).

    Examples:
        >>> search = GoalSearch(1, SearchRules(), torch.Generator().manual_seed(0))
        >>> search.begin(torch.tensor([0]), torch.tensor([[5.0, 5.0]]))
        >>> search.found(torch.tensor([True]), torch.tensor([[6.0, 5.0]]))
        >>> pose = torch.tensor([[3.0, 5.0, 0.0]])
        >>> aim = search.aim(pose, looks=torch.tensor([False]))
        >>> 5.0 < float(aim[0, 0]) < 6.5
        True
    """

    def __init__(
        self,
        num_agents: int,
        rules: SearchRules,
        generator: torch.Generator,
        *,
        turn: float = 20.0,
    ) -> None:
        self.rules = rules
        self.turn = turn
        self.generator = generator
        #: float32 ``[N, K, 2]``.
        self.points = torch.zeros(num_agents, _POINTS, 2)
        # How much they count as one, [N, K, K].
        self._alike = _alike(self.points)
        # What is known of each for this episode, and since the agent last started.
        self._likely = torch.ones(num_agents, _POINTS)
        self._left = torch.ones(num_agents, _POINTS)
        # What it aims at, for how many decisions, and where it was last.
        self._aim = torch.zeros(num_agents, 2)
        self._waited = torch.zeros(num_agents, dtype=torch.int64)
        self._last = torch.zeros(num_agents, 2)

    def begin(self, agents: Tensor, goal: Tensor) -> None:
        """Look around ``goal`` ``[n, 2]`` from now on; n agents begin an episode."""
        drawn = torch.randn(len(agents), _POINTS, 2, generator=self.generator)
        drawn[:, :_FAR] *= _FARTHER
        self.points[agents] = goal.unsqueeze(1) + drawn * self.rules.search
        self._alike[agents] = _alike(self.points[agents])
        self._likely[agents] = 1
        self._left[agents] = 1

    def restart(self, agents: Tensor) -> None:
        """The agents of a mask, bool ``[N]``, have been put elsewhere."""
        self._left[agents] = 1

    def found(self, agents: Tensor, position: Tensor) -> None:
        """The agents of a mask were paid at their ``position``, of all ``[N, 2]``."""
        drawn = torch.randn(len(agents), _PAID, 2, generator=self.generator)
        here = position.unsqueeze(1) + drawn * self.rules.reach
        points = torch.cat([self.points[:, :-_PAID], here], 1)
        self.points = torch.where(agents[:, None, None], points, self.points)
        self._alike[agents] = _alike(self.points[agents])
        gap = (self.points - position.unsqueeze(1)).norm(dim=2)
        # Poses are mistaken now and then: each time has a vote, and rules nothing out.
        vote = (-0.5 * (gap / self.rules.reach).square()).exp()
        likely = self._likely + _VOTE * vote
        self._likely = torch.where(agents.unsqueeze(1), likely, self._likely)

    def estimate(self) -> Tensor:
        """Where the goals most likely are, ``[N, 2]``."""
        share = self._likely / self._likely.sum(1, keepdim=True)
        return (share.unsqueeze(2) * self.points).sum(1)

    def aim(self, pose: Tensor, looks: Tensor) -> Tensor:
        """Where agents of a ``pose`` ``[N, 3]`` should go to look: ``[N, 2]``.

        Those of the mask ``looks``, bool ``[N]``, are looking, and were not paid here.
        """
        position = pose[:, :2]
        came = (position - self._last).norm(dim=1) > _MOVED
        self._last = torch.where((came | ~looks).unsqueeze(1), position, self._last)
        self._strike(looks & came, position, _PASSED)
        self._waited = torch.where(looks, self._waited + 1, 0)
        done = (self._aim - position).norm(dim=1) < _THERE
        done |= self._waited > _PATIENCE
        self._strike(looks & done, self._aim, _TRIED)
        self._waited[done] = 0
        best = self._best(pose, looks)
        self._aim = torch.where((done | ~looks).unsqueeze(1), best, self._aim)
        return self._aim

    def _best(self, pose: Tensor, looks: Tensor) -> Tensor:
        """The points around which most is left, those on the way before others."""
        left = (self._likely * self._left).unsqueeze(2)
        around = (self._alike @ left).squeeze(2)
        gap = self.points - pose[:, None, :2]
        bearing = torch.atan2(gap[..., 1], gap[..., 0]).rad2deg()
        off = ((bearing - pose[:, 2:] + 180) % 360 - 180).abs()
        away = gap.norm(dim=2)
        worth = around * (-(away + off / self.turn) / _WAY).exp()
        # Who looks was not paid here, and did not get to what it aimed at.
        tried = (self.points - self._aim.unsqueeze(1)).norm(dim=2)
        here = torch.minimum(away, tried) < _ELSEWHERE
        worth = worth.masked_fill(looks.unsqueeze(1) & here, 0.0)
        return self.points[torch.arange(len(worth)), worth.argmax(1)]

    def _strike(self, agents: Tensor, where: Tensor, share: float) -> None:
        """Leave that share of the points that agents, a mask, have ``[N, 2]`` at."""
        gap = (self.points - where.unsqueeze(1)).norm(dim=2) / _ALIKE
        left = self._left * (1 - (1 - share) * (-0.5 * gap.square()).exp())
        share_left = (self._likely * left).sum(1) / self._likely.sum(1)
        left[share_left < _BEGIN_AGAIN] = 1
        self._left = torch.where(agents.unsqueeze(1), left, self._left)


def _alike(points: Tensor) -> Tensor:
    """How much points ``[N, K, 2]`` count as one, ``[N, K, K]``."""
    found: Tensor = (-0.5 * (torch.cdist(points, points) / _ALIKE).square()).exp()
    return found
