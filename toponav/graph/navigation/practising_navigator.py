"""`PractisingNavigator`: walks to waypoints of its own map, to learn to steer."""

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from toponav import keys
from toponav.graph.navigation.pose_navigator import PoseNavigator

#: Steps from a waypoint at which it is reached, and decisions until it is given up.
_THERE, _LATE = 1.0, 200
#: Of the poses that an agent may have, those that say how much is left of its path, and
#: steps up to which waypoints beside them do: farther ones may be behind walls.
_ASKED, _BESIDE = 16, 2.5


class PractisingNavigator(PoseNavigator):
    """A `PoseNavigator` that chooses its own targets, and says how it comes along.

    Its targets are waypoints of its map, drawn uniformly. Once it believes to be there,
    or after a while, it draws the next one. Nobody tells it its pose, shows it a goal,
    or pays it: its progress is how much less is left of its path than in the decision
    before, by the mean over poses that it may have.

    Beside what a navigator writes, it writes what its controller reads and how it came
    along since the decision before: `keys.EMBEDDING`, `keys.SENSES`,
    `keys.FREE_LOGITS`, `keys.PROGRESS`, `keys.REACHED` and `keys.GAVE_UP`.

    Args:
        settings: arguments of `PoseNavigator` by name, with a ``controller``.
    """

    def __init__(self, **settings: Any) -> None:
        given = {
            "goal_reward": None,
            "in_keys": [keys.PIXELS, keys.PIXELS, keys.IS_INIT],
        }
        super().__init__(**(settings | given))
        said = [keys.EMBEDDING, keys.SENSES, keys.FREE_LOGITS]
        self.out_keys += [*said, keys.PROGRESS, keys.REACHED, keys.GAVE_UP]

    def _resize(self, num_agents: int, num_goal_views: int, length: int) -> None:
        super()._resize(num_agents, 1, length)
        self._left = torch.full((num_agents,), torch.nan)
        self._since = torch.zeros(num_agents, dtype=torch.int64)

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
        numbers = agents.nonzero().flatten()
        shape = (len(numbers), 1)
        nodes = torch.randint(self.map.num_waypoints, shape, generator=self.generator)
        embedding = self.map.embeddings[nodes].float()
        self.goals.put(numbers, embedding, nodes, torch.ones_like(nodes).bool())
        self._goal[numbers] = self.known.poses[nodes.squeeze(1), :2]
        self._aside[numbers] = 0
        self.plans.open_all(agents)
        self.plans.plan(numbers.tolist())
        self.progress.restart(agents)
        self._since[agents], self._left[agents] = 0, torch.nan

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
