"""Settings and batches of an exploration, without an engine."""

from pathlib import Path

import torch
from tensordict import TensorDict

from tests.composed import settings
from toponav import keys
from toponav.builders import World, make_networks, save_networks
from toponav.config import ExploreConfig
from toponav.methods import LEARNERS, make_world


def explore_settings(*overrides: str) -> ExploreConfig:
    """Settings at smoke scale with small networks."""
    found = settings(
        "explore",
        "scale=smoke",
        "model.embedding_dim=8",
        "policy.hidden=16",
        *overrides,
    )
    assert isinstance(found, ExploreConfig)
    # As in a run with networks, or one whose reward needs none.
    return found.resolved(found.model if found.reward.name == "novelty" else None)


def make_policy(config: ExploreConfig) -> torch.nn.Module:
    return LEARNERS[config.loss.name].make_policy(config, world_of(config))


def world_of(config: ExploreConfig) -> World:
    """The maze of the settings; no engine is started."""
    return make_world(config)


def save_untrained(path: Path) -> None:
    """Write networks that were never trained: enough to explore with."""
    torch.manual_seed(0)
    config = explore_settings()
    made = make_networks(config.model, world_of(config).spec)
    made.thresholds = {"reward_threshold": 0.5, "tc_threshold": 0.9, "tc_reach": 0.7}
    save_networks(made, path)


def make_batch(
    config: ExploreConfig,
    *,
    envs: tuple[int, ...] = (0, 1, 2, 3),
    start: int = 0,
    seed: int = 0,
) -> TensorDict:
    """What a collector would hand over: ``[E, T]`` with made-up views and rewards.

    Args:
        config: settings of the run.
        envs: numbers of the environments.
        start: decisions of each environment before this batch.
        seed: of views, rewards and actions.
    """
    length, total = config.loss.rollout, config.world.episode_length
    shape = (len(envs), length)
    generator = torch.Generator().manual_seed(seed)
    policy = make_policy(config)
    step = (start + torch.arange(length)) % total + 1
    done = (step == total).expand(*shape).unsqueeze(-1)
    reward = torch.rand(*shape, 1, generator=generator)
    view = torch.randn(len(envs), length + 1, 8, generator=generator)
    flags = torch.zeros(*shape, 1, dtype=torch.bool)
    count = torch.ones(*shape, 1, dtype=torch.int64)
    version = {"policy": count, "networks": 0 * count}
    privileged = {
        "coverage": reward / 2,
        "coverage_reward": reward,
        "spurious_waypoint": flags,
        "position": torch.zeros(*shape, 2),
        "heading": torch.zeros(*shape, 1),
        "cell": torch.ones(*shape, 2, dtype=torch.int64),
    }
    policy_input = {
        "previous_action": 6 * count,
        "previous_reward": 0 * reward,
        "recurrent_state": policy.initial_state(*shape),
        "is_new_waypoint": ~flags,
        "privileged": privileged,
    }
    following = {
        **policy_input,
        "embedding": view[:, 1:],
        keys.DONE: done,
        keys.TERMINATED: flags,
        keys.TRUNCATED: done,
        keys.INTRINSIC_REWARD: reward,
        keys.COUNT_REWARD: 0.25 * reward,
        keys.TEMPORAL_DISTANCE_REWARD: 0.75 * reward,
        keys.NUM_WAYPOINTS: 5 * count,
        "step_count": step.expand(*shape).unsqueeze(-1).clone(),
    }
    batch = TensorDict(
        {
            **policy_input,
            "embedding": view[:, :-1],
            keys.IS_INIT: (step == 1).expand(*shape).unsqueeze(-1).clone(),
            keys.ENV_ID: torch.tensor(envs).reshape(-1, 1, 1).expand(*shape, 1),
            "version": version,
            "next": following,
        },
        shape,
    )
    torch.manual_seed(seed)
    with torch.no_grad():
        decided = [policy(one).exclude("next") for one in batch.unbind(1)]
    batch.update(torch.stack(decided, 1))
    return batch
