"""The consumers of an exploration's batches, from its settings."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from toponav.builders import (
    NETWORKS,
    Consumer,
    Learner,
    Networks,
    RewardMethod,
    World,
    load_policy,
    make_autocast,
)
from toponav.config import ExploreConfig
from toponav.methods import LEARNERS
from toponav.runs import CHECKPOINT_FILE
from toponav.training.checkpoints import ExplorationState
from toponav.training.continued_training import ContinuedTraining, LocomotionFinetuner
from toponav.training.episode_log import EpisodeLog, mean_of
from toponav.training.map_growth import MapGrowth
from toponav.training.pair_trainer import require_finite
from toponav.training.recalibration import Recalibration, walk_for_calibration


class BestPolicy(Consumer):
    """Keeps the policy whenever the last episodes were better than ever before.

    Rewards by different versions of the networks do not compare: a new version starts
    the comparison again.

    Args:
        policy: as it is trained.
        log: of finished episodes; it takes each batch before.
        state: of the run; says which version of the networks collectors use now.
        metric: the column of the log that counts, in the mean of ``window`` episodes.
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


def make_learner(
    settings: ExploreConfig,
    world: World,
    reward: RewardMethod,
    state: ExplorationState,
    folder: Path,
) -> Learner:
    """The learner that the settings name; ``state`` gives it the run's progress.

    It begins with the policy of ``init_policy``, if that names one.

    Raises:
        SettingsError: if that policy does not fit.
    """
    learner = LEARNERS[settings.loss.name](
        settings,
        world,
        reward=reward.reward_key,
        check=partial(require_finite, folder=folder, setting="loss.lr"),
        progress=lambda: state.progress,
    )
    # A resumed run has its own policy, unless it was cut off before it kept one.
    begins = not settings.resume or not (folder / CHECKPOINT_FILE).is_file()
    if settings.init_policy is not None and begins:
        load_policy(settings.init_policy, learner.policy)
        learner.synchronise()
    return learner


def make_consumers(
    settings: ExploreConfig,
    world: World,
    networks: Networks | None,
    learner: Learner,
    reward: RewardMethod,
    state: ExplorationState,
    folder: Path,
) -> tuple[EpisodeLog, dict[str, Consumer]]:
    """The log, and all consumers, in the order in which they get the batches.

    The log comes before those that ask which episodes have ended. What is switched off
    is not in it, and without networks there is no map.
    """
    log = EpisodeLog(settings.collect.envs, world, reward)
    consumers: dict[str, Consumer] = {"episodes": log, "learner": learner}
    if (metric := reward.selection_metric) is not None:
        last = settings.report.best_of
        best = BestPolicy(learner.policy, log, state, metric=metric, window=last)
        consumers["best"] = best
    consumers["reward"] = reward
    if networks is None:
        return log, consumers
    if settings.online.learn:
        check = partial(require_finite, folder=folder, setting="online.lr")
        recalibrate = Recalibration(
            walk_for_calibration(settings, world),
            networks,
            k=settings.pairs.k,
            autocast=make_autocast(networks.device, bf16=True),
        )
        # Before the map, which is embedded by the networks that it restores or leaves.
        consumers["online"] = ContinuedTraining(
            settings, networks, check, reward=reward, recalibrate=recalibrate
        )
    by_poses = False
    if settings.map.grow:
        growth = MapGrowth(settings, world, networks, folder)
        consumers["map"], by_poses = growth, growth.effects is not None
    # Continued training trains the whole L-network; and a head can learn from stored
    # embeddings only if its encoder made them.
    shares = networks.locomotion.encoder is networks.tc.encoder
    if settings.trains_head(by_poses=by_poses) and shares:
        check = partial(require_finite, folder=folder, setting="locomotion.lr")
        consumers["locomotion"] = LocomotionFinetuner(settings, networks, check)
    return log, consumers


def needed_keys(consumers: Mapping[str, Consumer]) -> list[NestedKey]:
    """What collectors hand over: all that any consumer reads."""
    return list(dict.fromkeys(key for one in consumers.values() for key in one.in_keys))


def finish(
    consumers: Mapping[str, Consumer],
    folder: Path,
    *,
    beside: bool,
    progress: Callable[[float], object] = lambda _: None,
) -> None:
    """Finish those that change what explorers use, or those that can beside them.

    ``progress`` is called with the share that is done.
    """
    those = [one for one in consumers.values() if one.finishes_beside == beside]
    for number, consumer in enumerate(those):

        def of_all(share: float, number: int = number) -> None:
            progress((number + share) / len(those))

        consumer.finish(folder, of_all)
    progress(1.0)


def trained_policies(
    settings: ExploreConfig,
    world: World,
    learner: Learner,
    consumers: Mapping[str, Consumer],
) -> dict[str, TensorDictModuleBase]:
    """The policies to evaluate, on the CPU: the last, and the best if one was kept.

    A run too short to choose from has the last policy as its best, too.
    """
    policies = {"last": learner.policy.cpu()}
    if "best" in consumers:
        best = learner.make_policy(settings, world)
        kept = consumers["best"].state_dict()["weights"]
        best.load_state_dict(kept or policies["last"].state_dict())
        policies = {"best": best, **policies}
    for policy in policies.values():
        learner.settle(policy)
    return policies
