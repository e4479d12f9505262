"""The environment that an explorer learns in: a maze, its novelty and its truth."""

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.envs import Compose, EnvBase, InitTracker, StepCounter, TransformedEnv
from torchrl.envs.transforms import Transform

from toponav.builders.mazes import make_env
from toponav.builders.novelty import Novelty
from toponav.collectors import StaggeredEpisodes
from toponav.config import ExploreConfig
from toponav.envs import DoomMazeEnv
from toponav.keys import COVERAGE_REWARD, INTRINSIC_REWARD
from toponav.modules import ActorCritic, TCNetwork
from toponav.transforms import (
    AreaDownsample,
    CountReward,
    Coverage,
    IntrinsicReward,
    NoisyTV,
    PolicyPixels,
    PreviousAction,
    PreviousReward,
    TemporalDistanceReward,
    WaypointMemory,
    WaypointTruth,
)

#: Levels of coverage whose decisions are recorded.
COVERAGE_LEVELS = (0.5, 0.9, 1.0)


def make_actor_critic(config: ExploreConfig) -> ActorCritic:
    """The explorer's network; `PolicyConfig` says what it sees and how wide it is."""
    policy = config.policy
    return ActorCritic(
        input=policy.input,  # type: ignore[arg-type]
        embedding_dim=config.model.embedding_dim,
        code_dim=policy.hidden,
        hidden_dim=policy.hidden,
    )


def make_explore_env(
    config: ExploreConfig,
    novelty: Novelty,
    *,
    envs: int,
    seed: int,
    stagger: bool = False,
) -> EnvBase:
    """A batch of mazes with everything that the explorer and its log read.

    The truth (coverage, false births, poses) is there for the log alone; no network
    reads a privileged key.

    Args:
        config: settings of the run.
        novelty: the TC-network, in ``eval()`` mode, and the reward's threshold.
        envs: number of mazes E side by side.
        seed: of the episodes.
        stagger: whether the first episodes are cut at different lengths.

    Raises:
        SettingsError: if the settings do not fit the maze.
        EngineError: if the engine cannot start.
    """
    maze = make_env(config.maze, batch_size=envs, seed=seed, privileged=True)
    transforms = [
        *_make_views(config, seed=seed),
        make_memory(config, novelty),
        *_make_rewards(config),
        PreviousAction(),
        *_make_truth(maze),
        PreviousReward(in_keys=[reward_key(config)]),
        *([StaggeredEpisodes(config.maze.episode_length)] if stagger else []),
        InitTracker(),
        StepCounter(),
        make_actor_critic(config).make_tensordict_primer(),
    ]
    return TransformedEnv(maze, Compose(*transforms))


def reward_key(config: ExploreConfig) -> NestedKey:
    """The key of what the explorer learns from."""
    if config.reward.kind == "coverage":
        return COVERAGE_REWARD
    return INTRINSIC_REWARD


def _make_views(config: ExploreConfig, *, seed: int) -> list[Transform]:
    """Noise, the policy's copy, and what is left for the TC-network."""
    views: list[Transform] = []
    if config.collect.noisy_tv:
        views.append(NoisyTV(seed=seed))
    if config.policy.input == "pixels":
        views.append(PolicyPixels())
    if config.halve:
        views.append(AreaDownsample())
    return views


def make_memory(config: ExploreConfig, novelty: Novelty) -> WaypointMemory:
    """The memory of waypoints; it keeps their views only if the networks change."""
    reward, tc = config.reward, novelty.tc
    dtype = tc_dtype(tc)

    def compare(embedding: Tensor, prepared: Tensor) -> Tensor:
        return tc.compare_prepared(embedding.to(dtype), prepared.to(dtype))

    def prepare(memory: Tensor) -> Tensor:
        return tc.prepare_memory(memory.to(dtype)).float()

    return WaypointMemory(
        tc.embed,
        compare,
        prepare=prepare,
        capacity=reward.capacity,
        threshold=float(novelty.threshold),
        replacement=reward.replacement,  # type: ignore[arg-type]
        persistence=reward.persistence,
        min_gap=reward.min_gap,
        count_on=reward.count_on,  # type: ignore[arg-type]
        aggregate="max" if reward.aggregate == "max" else float(reward.aggregate),
        keep_images=config.online.learn,
    )


def tc_dtype(tc: TCNetwork) -> torch.dtype:
    """In which precision a TC-network computes."""
    return next(tc.parameters()).dtype


def _make_rewards(config: ExploreConfig) -> list[Transform]:
    reward = config.reward
    (alpha, beta), combine = reward.weights, reward.combine
    return [
        CountReward(alpha, combine=combine),  # type: ignore[arg-type]
        TemporalDistanceReward(
            beta,
            floor=reward.floor,
            clip=reward.clip,
            combine=combine,  # type: ignore[arg-type]
        ),
        IntrinsicReward(combine),  # type: ignore[arg-type]
    ]


def _make_truth(maze: DoomMazeEnv) -> list[Transform]:
    layout = maze.layout
    return [
        Coverage(
            torch.as_tensor(layout.open_mask),
            COVERAGE_LEVELS,
            slot_cells=list(layout.slots.values()),
        ),
        WaypointTruth(),
    ]
