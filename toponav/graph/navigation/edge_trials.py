"""`EdgeTrials`: how often edges were walked, tried in vain, and how long it took."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree
from torch import Tensor

from toponav.graph.navigation.plans import Plans

#: Passes that the first guess of an edge's cost counts for.
_GUESS = 2.0
#: Trials that count at most: what happened before them counts less and less.
_MEMORY = 20.0
#: Times its guessed cost, and decisions more, that a trial may take: a turn to what is
#: behind takes nine.
_SLOW, _SLACK = 2.0, 8.0
#: An edge is a mistake after so many trials, there and back, of which no more than this
#: share passed.
_MISTAKES, _WORTH = 2, 0.02


class EdgeTrials:
    """What trials to walk over each of E edges showed, there and back.

    A trial is one attempt of an agent to get from one end of an edge to the other. Of
    those in one direction the last 20 count, the ones before less and less: what was
    closed may open.

    Examples:
        >>> trials = EdgeTrials(torch.tensor([[0, 1], [1, 2]]))
        >>> ends, decisions = torch.tensor([[1, 2], [1, 0]]), torch.tensor([4, 12])
        >>> trials.add(ends, torch.tensor([True, False]), decisions)
        >>> trials.success.tolist()  # of the first edge back, of the second there
        [[nan, 0.0], [1.0, nan]]
        >>> trials.costs(torch.tensor([2.0, 2.0]))  # 4 decisions pass what costs 2:
        tensor([[2., 5.],
                [2., 2.]])
        >>> (2 * 2 + 12 / 2) / 2, (2 * 2 + 4 / 2) / (2 + 1)  # back over 1, to 2
        (5.0, 2.0)
    """

    def __init__(self, edges: Tensor) -> None:
        #: int64 ``[E, 2]``; there is from the first end of each to the second.
        self.edges = edges.cpu()
        #: Trials, and those that passed, there and back, float32 ``[E, 2]``.
        self.tried = torch.zeros(len(edges), 2)
        self.passed = torch.zeros(len(edges), 2)
        #: Decisions of those that passed, and of the others, float32 ``[E, 2]``.
        self.walked = torch.zeros(len(edges), 2)
        self.lost = torch.zeros(len(edges), 2)
        ways = ((self.edges, 0), (self.edges.flip(1), 1))
        self._at = {
            (start, end): (number, way)
            for ends, way in ways
            for number, (start, end) in enumerate(ends.tolist())
        }

    @property
    def success(self) -> Tensor:
        """Share of the trials that passed, ``[E, 2]``, NaN where there were none."""
        return self.passed / self.tried

    @property
    def confirmed(self) -> Tensor:
        """Which edges were passed in a direction, bool ``[E, 2]``."""
        return self.passed > 0

    @property
    def mistaken(self) -> Tensor:
        """Which edges were tried in vain, twice or more, bool ``[E]``."""
        tried, passed = self.tried.sum(1), self.passed.sum(1)
        return (tried >= _MISTAKES) & (passed <= _WORTH * tried)

    def kept(self, num_waypoints: int) -> Tensor:
        """Edges to plan on, bool ``[E]``: all but mistakes that nothing hangs on.

        A mistake stays, at its cost, where a part of the map would be cut off.
        """
        shape = num_waypoints, num_waypoints
        weights = 1.0 + self.mistaken.numpy()
        tree = minimum_spanning_tree(csr_array((weights, self.edges.T), shape))
        kept = ~self.mistaken
        for ends in zip(*tree.nonzero(), strict=True):
            kept[self._at[ends][0]] = True
        return kept

    def costs(self, guess: Tensor) -> Tensor:
        """What a pass of each edge costs, there and back, float32 ``[E, 2]``.

        All decisions that were spent on an edge count, those in vain too, and ``guess``
        ``[E]`` or ``[E, 2]``, of the same meaning, as what two more passes took. They
        are in its unit, of which a decision makes as much as in all trials that passed:
        an edge that nobody tried is neither dear nor cheap.
        """
        guess = _there_and_back(guess)
        passed = float((guess * self.passed).sum())
        pace = float(self.walked.sum()) / passed if passed else 1.0
        spent = (self.walked + self.lost) / pace
        return (_GUESS * guess + spent) / (_GUESS + self.passed)

    def add(self, ends: Tensor, passed: Tensor, decisions: Tensor) -> None:
        """Count K trials.

        Args:
            ends: the waypoints from which and to which each led, int64 ``[K, 2]``.
            passed: whether it got there, bool ``[K]``.
            decisions: that it took, ``[K]``.
        """
        found = ends.tolist(), passed.tolist(), decisions.tolist()
        for (start, end), got_there, took in zip(*found, strict=True):
            at = self._at[start, end]
            counts = self.tried, self.passed, self.walked, self.lost
            if self.tried[at] >= _MEMORY:
                for count in counts:
                    count[at] *= 1 - 1 / _MEMORY
            self.tried[at] += 1
            self.passed[at] += got_there
            (self.walked if got_there else self.lost)[at] += took

    def state_dict(self) -> dict[str, Tensor]:
        names = "edges", "tried", "passed", "walked", "lost"
        return {name: getattr(self, name).clone() for name in names}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take what a `state_dict` has.

        Raises:
            ValueError: if it has other edges, or its counts do not fit together.
        """
        if not torch.equal(state["edges"], self.edges):
            given, own = len(state["edges"]), len(self.edges)
            raise ValueError(f"edges must be the map's own {own}, got other {given}")
        found = {name: state[name] for name in ("tried", "passed", "walked", "lost")}
        for name, one in found.items():
            if one.shape != self.tried.shape:
                rule = f"trials must be {list(self.tried.shape)} numbers"
                raise ValueError(f"{rule}, got {list(one.shape)} in {name}")
            if len(bad := one[~(one.isfinite() & (one >= 0))]):
                rule = "trials must be finite numbers of 0 or more"
                raise ValueError(f"{rule}, got {bad[0]:g} in {name}")
        tried, passed, walked, lost = (one.float().clone() for one in found.values())
        if len(more := (passed > tried).nonzero()):
            at = tuple(more[0])
            rule = "trials must be as many as passed, or more"
            raise ValueError(f"{rule}, got {tried[at]:g} of {passed[at]:g}")
        if len(fast := passed[(passed > 0) & (walked == 0)]):
            rule = "trials that passed must have taken decisions"
            raise ValueError(f"{rule}, got {fast[0]:g} in none")
        self.tried, self.passed, self.walked, self.lost = tried, passed, walked, lost

    def num_unconfirmed(self, path: Sequence[int]) -> int:
        """Edges of a path of waypoints that nobody has passed in that direction."""
        return sum(not self.passed[self._at[step]] for step in pairwise(path))


class TrialWatch:
    """Watches N agents on their paths, and counts their trials of edges.

    A trial begins at a place whose path leads over an edge. It passes once what is left
    of the path is no more than from the edge's other end, and is in vain when the agent
    closes the edge or takes longer than twice the guessed cost and eight decisions.
    Whoever gets a new path is not judged.

    Args:
        trials: counts them.
        guess: decisions that each edge may cost, ``[E]``, or ``[E, 2]``, also back.
        num_agents: N.
    """

    def __init__(self, trials: EdgeTrials, guess: Tensor, num_agents: int) -> None:
        self.trials = trials
        self._guess = _there_and_back(guess.cpu())
        self._ends = torch.full((num_agents, 2), -1)
        self._number = torch.full((num_agents,), -1)
        # By which of its plans an agent began its trial.
        self._plan = torch.zeros(num_agents, dtype=torch.int64)
        # What is left from the other end, and decisions since it began.
        self._left = torch.zeros(num_agents, dtype=torch.float64)
        self._since = torch.zeros(num_agents, dtype=torch.int64)

    def follow(self, place: Tensor, plans: Plans, *, gave_up: Tensor) -> None:
        """Count a decision of each agent, at its place, int64 ``[N]``, on its plan.

        ``gave_up``, bool ``[N]``: who closed edges in it, and has a new plan.
        """
        if not len(self.trials.edges):
            return
        # A new plan, such as over edges that opened, has another cost for the same way.
        is_same = gave_up | (plans.num_plans == self._plan)
        on_trial, left = (self._number >= 0) & is_same, plans.cost(place)
        self._since += on_trial
        passed = on_trial & ~gave_up & (left <= self._left)
        number = self._number.clamp(min=0)
        closed = gave_up & plans.closed[torch.arange(len(place)), number]
        way = (self.trials.edges[number, 0] != self._ends[:, 0]).long()
        slow = self._since > _SLOW * self._guess[number, way] + _SLACK
        over = passed | (on_trial & (closed | slow))
        if over.any():
            self.trials.add(self._ends[over], passed[over], self._since[over])
        self._number[over | gave_up | ~is_same] = -1
        self._begin(place, plans)

    def _begin(self, place: Tensor, plans: Plans) -> None:
        """Whoever is on no trial and has a path begins one."""
        here = place.clamp(min=0)
        onward = plans.ahead(here, 1).squeeze(1)
        number = plans.planner.edge_numbers(here, onward)
        begins = (self._number < 0) & (place >= 0) & (number >= 0)
        self._number = torch.where(begins, number, self._number)
        ends = torch.stack([here, onward], 1)
        self._ends = torch.where(begins.unsqueeze(1), ends, self._ends)
        self._left = torch.where(begins, plans.cost(onward), self._left)
        self._plan = torch.where(begins, plans.num_plans, self._plan)
        self._since = self._since.masked_fill(begins, 0)


def _there_and_back(cost: Tensor) -> Tensor:
    """Costs of edges ``[E, 2]``, given as such or as ``[E]``, the same both ways."""
    return cost if cost.ndim == 2 else cost.unsqueeze(1).expand(-1, 2)
