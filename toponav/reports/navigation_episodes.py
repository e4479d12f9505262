"""The episodes that navigators and those they are compared with play."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import pandas as pd
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase, TransformedEnv

from toponav import metrics
from toponav.builders import (
    GoalPlaces,
    GroundTruth,
    Rollout,
    make_navigation_env,
    seed_of,
)
from toponav.config import NavigateConfig
from toponav.graph import Map
from toponav.keys import GOAL_VIEWS
from toponav.methods.navigators import TrainedPolicy
from toponav.reports.episodes import play_episodes

# Apart from the seeds of the walk for pictures.
_EPISODES = 66


@dataclass(frozen=True)
class NavigationEpisodes:
    """The episodes of one policy."""

    policy: str
    trace: metrics.NavigationTrace
    legs: pd.DataFrame  # the table of `measure_legs`
    views: Tensor  # uint8 [V, H, W, 3]; what the first episode showed at its beginning
    goal: Tensor  # uint8 [H, W, 3]; the first picture of its goal
    map: Map | None  # on which the policy plans, if it plans on one


def play_policies(
    config: NavigateConfig,
    truth: GroundTruth,
    places: GoalPlaces,
    policies: Mapping[str, TensorDictModuleBase],
) -> list[NavigationEpisodes]:
    """Play whole episodes; all policies meet the same mazes, starts and goals.

    A `TrainedPolicy` plays them in environments that show it what it was trained with.
    """
    trained = {
        name: one for name, one in policies.items() if isinstance(one, TrainedPolicy)
    }
    others = {name: one for name, one in policies.items() if name not in trained}
    played = _play(config, places, others) if others else {}
    for name, policy in trained.items():
        played |= _play(config, places, {name: policy}, trained=policy)
    found = []
    for name in policies:
        one = played[name]
        trace = metrics.trace_navigation(one.frames)
        legs = metrics.measure_legs(trace, truth.distances)
        goal, plans_on = one.start[GOAL_VIEWS][0], getattr(policies[name], "map", None)
        found.append(NavigationEpisodes(name, trace, legs, one.views, goal, plans_on))
    return found


def _play(
    config: NavigateConfig,
    places: GoalPlaces,
    policies: Mapping[str, TensorDictModuleBase],
    *,
    trained: TrainedPolicy | None = None,
) -> dict[str, Rollout]:
    """The episodes of each policy, in environments of all of them."""

    def make_env(envs: int) -> EnvBase:
        make = partial(make_navigation_env, config, places, envs=envs, seed=0)
        if trained is None:
            return make()
        env = make(velocity="velocity" in trained.senses)
        return TransformedEnv(env, Compose(*trained.make_transforms()))

    return play_episodes(
        make_env,
        policies,
        dict.fromkeys(policies, config.evaluate.episodes),
        config.maze.episode_length,
        seed=seed_of(config.seed, _EPISODES),
        # Its actions must not depend on who played before.
        action_seed=None if trained is None else seed_of(config.seed, _EPISODES, 1),
        keep=metrics.TRACE_KEYS,
        keep_next=metrics.TRACE_NEXT_KEYS,
        views=config.video.decisions,
    )
