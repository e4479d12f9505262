"""`PractisingNavigator`: walks to waypoints of its own map, to learn to steer."""

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from toponav import keys
from toponav.graph.navigation.edge_trials import EdgeTrials, TrialWatch
from toponav.graph.navigation.planner import Planner
from toponav.graph.navigation.pose_navigator import PoseNavigator

#: Steps from a waypoint at which it is reached, and decisions until it is given up.
_THERE, _LATE = 1.0, 200
#: Of the poses that an agent may have, those that say how much is left of its path, and
#: steps up to which waypoints beside them do: farther ones may be behind walls.
_ASKED, _BESIDE = 16, 2.5
#: Waypoints of which that one becomes the target whose path has the most to confirm.
_CHOICES = 4


class PractisingNavigator(PoseNavigator):
    """A `PoseNavigator` that chooses its own targets, and says how it comes along.

    Its targets are waypoints of its map, drawn uniformly. Once it believes to be there,
    or after a while, it draws the next one. Nobody tells it its pose, shows it a goal,
    or pays it: its progress is how much less is left of its path than in the decision
    before, by the mean over poses that it may have.

    What it learns of the edges that it walks, `trials` keeps, and its next plans cost
    what those showed. A share of its targets is chosen for that: of four waypoints the
    one whose path has the most edges that nobody has passed.

    Beside what a navigator writes, it writes what its controller reads and how it came
    along since the decision before: `keys.EMBEDDING`, `keys.SENSES`,
    `keys.FREE_LOGITS`, `keys.PROGRESS`, `keys.REACHED` and `keys.GAVE_UP`.

    Args:
        confirm: share of the targets whose paths are to confirm edges, in [0, 1].
        settings: arguments of `PoseNavigator` by name, with a ``controller``.
    """

    def __init__(self, *, confirm: float = 0.0, **settings: Any) -> None:
        given = {
            "goal_reward": None,
            "in_keys": [keys.PIXELS, keys.PIXELS, keys.IS_INIT],
        }
        super().__init__(**(settings | given))
        said = [keys.EMBEDDING, keys.SENSES, keys.FREE_LOGITS]
        self.out_keys += [*said, keys.PROGRESS, keys.REACHED, keys.GAVE_UP]
        if not 0 <= confirm <= 1:
            raise ValueError(f"confirm must be in [0, 1], got {confirm}")
        self.confirm = confirm
        #: Of the map's edges.
        self.trials = EdgeTrials(self.map.edges)

    def _resize(self, num_agents: int, num_goal_views: int, length: int) -> None:
        super()._resize(num_agents, 1, length)
        self._left = torch.full((num_agents,), torch.nan)
        self._since = torch.zeros(num_agents, dtype=torch.int64)
        self._watch = TrialWatch(self.trials, self.map.edge_cost, num_agents)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        tensordict = super().forward(tensordict)
        shape, device = tensordict.batch_size, tensordict.device
        for key, value in self._said.items():
            value = value.reshape(*shape, *value.shape[1:])
            tensordict.set(key, value.to(device))
        return tensordict

    def _require_views(self, views: Tensor, goal_views: Tensor) -> None:
        """It is shown no goal."""

    def _begin(self, begins: Tensor, goal_views: Tensor) -> None:
        self._choose(begins)

    def _choose(self, agents: Tensor) -> None:
        """New targets for the agents of a mask, bool ``[N]``."""
        numbers, waypoints = agents.nonzero().flatten(), self.map.num_waypoints
        cost = self.trials.costs(self.map.edge_cost)
        self.plans.planner = Planner(waypoints, self.map.edges, cost)
        shape = (len(numbers), _CHOICES)
        nodes = torch.randint(waypoints, shape, generator=self.generator)
        confirms = torch.rand(len(numbers), generator=self.generator) < self.confirm
        for row in confirms.nonzero().flatten().tolist():
            start = int(self.localiser.place[numbers[row]])
            most = [-self._unconfirmed(start, node) for node in nodes[row].tolist()]
            nodes[row] = nodes[row, torch.tensor(most).argsort(stable=True)]
        nodes = nodes[:, :1]
        embedding = self.map.embeddings[nodes].float()
        self.goals.put(numbers, embedding, nodes, torch.ones_like(nodes).bool())
        self._goal[numbers] = self.known.poses[nodes.squeeze(1), :2]
        self._aside[numbers] = 0
        self.plans.open_all(agents)
        self.plans.plan(numbers.tolist())
        self.progress.restart(agents)
        self._since[agents], self._left[agents] = 0, torch.nan

    def _unconfirmed(self, start: int, goal: int) -> int:
        """Edges of the path from a waypoint to another that nobody has passed."""
        if start < 0:
            return 0
        onward = self.plans.planner.plan([goal]).onward.tolist()
        path = [start]
        while (then := onward[path[-1]]) != path[-1]:
            path.append(then)
        return self.trials.num_unconfirmed(path)

    def _give_up(self, place: Tensor) -> Tensor:
        ends = super()._give_up(place)
        self._watch.follow(place, self.plans, gave_up=(ends >= 0).any(1))
        return ends

    def _locate(self, embedding: Tensor, data: TensorDictBase) -> Tensor:
        place = super()._locate(embedding, data)
        left = self._to_go(place)
        progress = (self._left - left).nan_to_num(0.0, 0.0, 0.0)
        self._since += 1
        target = self.known.poses[self.goals.nodes[:, 0], :2]
        reached = (self._pose[:, :2] - target).norm(dim=1) < _THERE
        late = (self._since > _LATE) & ~reached
        self._said: Mapping[Any, Tensor] = {
            keys.PROGRESS: progress.unsqueeze(1),
            keys.REACHED: reached.unsqueeze(1),
            keys.GAVE_UP: late.unsqueeze(1),
        }
        self._left = left
        if (done := reached | late).any():
            self._choose(done)
            self._left = torch.where(done, self._to_go(place), left)
        return place

    def _to_go(self, place: Tensor) -> Tensor:
        """Decisions that are left, ``[N]``: the mean over poses that each may have.

        Where none of them has a path, as from ``place``.
        """
        away = torch.cdist(self.belief.poses[:, :_ASKED, :2], self.known.track)
        left = self.plans.costs.float().unsqueeze(1) + away
        least = left.masked_fill(away > _BESIDE, torch.inf).amin(2)
        known = least.isfinite()
        mean = least.masked_fill(~known, 0).sum(1) / known.sum(1)
        return torch.where(mean.isfinite(), mean, self.plans.cost(place).float())

    def _steer(self, here: Tensor, there: Tensor) -> Tensor:
        logits = super()._steer(here, there)
        self._said = {
            **self._said,
            keys.EMBEDDING: here.float().cpu(),
            keys.SENSES: self._sensed,
            keys.FREE_LOGITS: self._free,
        }
        return logits
