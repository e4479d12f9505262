"""`BestPolicy`: the weights that did best in training."""

import math
from collections.abc import Mapping

from tensordict import TensorDictBase
from torch import Tensor, nn

from toponav.builders import NETWORKS, Consumer
from toponav.training.episode_log import EpisodeLog, mean_of
from toponav.training.exploration_state import ExplorationState


class BestPolicy(Consumer):
    """Keeps the policy whenever the last episodes were better than ever before.

    Rewards by different versions of the networks do not compare: a new version starts
    the comparison again.

    Args:
        policy: as it is trained.
        log: of finished episodes; it must come before in the list of consumers.
        state: of the run; says which version of the networks collectors use now.
        metric: the column of the log that counts.
        window: episodes to take the mean of; fewer are not enough.
    """

    saved = ("best", "best_version", "best_decisions", "weights")

    def __init__(
        self,
        policy: nn.Module,
        log: EpisodeLog,
        state: ExplorationState,
        *,
        metric: str,
        window: int,
    ) -> None:
        self.policy = policy
        self.log = log
        self.state = state
        self.metric = metric
        self.window = window
        self.best = -math.inf
        self.best_version = self.best_decisions = 0
        #: Weights on the CPU, ``None`` before the first.
        self.weights: dict[str, Tensor] | None = None

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        if not self.log.ended:
            return {}
        version = self.state.versions.get(NETWORKS, 0)
        last = [row for row in self.log.rows if row["networks_version"] == version]
        if len(last) < self.window:
            return {}
        mean = mean_of(last[-self.window :], self.metric)
        if version == self.best_version and mean <= self.best:
            return {}
        self.best, self.best_version = mean, version
        self.best_decisions = self.log.decisions
        weights = self.policy.state_dict().items()
        self.weights = {name: value.cpu().clone() for name, value in weights}
        return {}
