"""`Explorer`: what acts in an exploration, in the learning and collecting processes."""

from dataclasses import dataclass

import torch
from torch import nn
from torchrl.envs import Compose, EnvBase, InitTracker, StepCounter, TransformedEnv
from torchrl.envs.transforms import Transform

from toponav.builders import (
    NETWORKS,
    POLICY,
    Networks,
    Novelty,
    RewardMethod,
    World,
    make_empty_novelty,
)
from toponav.collectors import StaggeredEpisodes
from toponav.config import ExploreConfig
from toponav.methods import LEARNERS, make_reward
from toponav.modules import ActorCritic
from toponav.transforms import (
    AreaDownsample,
    Coverage,
    EmbedViews,
    NoisyTV,
    PolicyPixels,
    PreviousAction,
    PreviousReward,
)

#: Levels of coverage whose decisions are recorded.
COVERAGE_LEVELS = (0.5, 0.9, 1.0)


@dataclass
class Explorer:
    """A policy, its reward method, and the TC-network if the run has one.

    Args:
        policy: acts.
        reward: rewards it.
        novelty: embeds views, for the policy and the map; ``None`` without networks.
    """

    policy: ActorCritic
    reward: RewardMethod
    novelty: Novelty | None

    def modules(self) -> dict[str, nn.Module]:
        """All that collecting processes fetch, by the name it is published under."""
        networks = {} if self.novelty is None else {NETWORKS: self.novelty}
        return {POLICY: self.policy, **networks, **self.reward.modules()}


def make_explorer(
    policy: ActorCritic, reward: RewardMethod, networks: Networks | None
) -> Explorer:
    """The explorer of the learning process, which publishes its weights."""
    shared = reward.modules().get(NETWORKS)
    if isinstance(shared, Novelty):
        return Explorer(policy, reward, shared)
    novelty = None if networks is None else Novelty(networks.tc)
    return Explorer(policy, reward, novelty)


def make_worker_explorer(
    settings: ExploreConfig, world: World, *, has_networks: bool
) -> Explorer:
    """The explorer of a collecting process; its weights are fetched from a mailbox."""
    policy = LEARNERS[settings.loss.name].make_policy(settings, world)
    reward = make_reward(settings, world, None)
    shared = reward.modules().get(NETWORKS)
    if isinstance(shared, Novelty):
        return Explorer(policy, reward, shared)
    novelty = make_empty_novelty(settings.model, world.spec) if has_networks else None
    return Explorer(policy, reward, novelty)


def make_explore_env(
    settings: ExploreConfig,
    world: World,
    explorer: Explorer,
    *,
    envs: int,
    seed: int,
    stagger: bool = False,
) -> EnvBase:
    """A batch of environments with everything that the explorer and its log read.

    Ground truth (coverage, spurious waypoints, poses) is there for the log alone; no
    network reads a privileged key.

    Args:
        settings: of the run.
        world: where the explorer acts.
        explorer: its networks in ``eval()`` mode.
        envs: number E of environments side by side.
        seed: of the episodes.
        stagger: whether the first episodes are cut at different lengths.

    Raises:
        SettingsError: if the settings do not fit the world.
        EngineError: if the engine cannot start.
    """
    env = world.make_env(batch_size=envs, seed=seed, privileged=world.spec.has_truth)
    reward = explorer.reward
    transforms = [
        *_make_views(settings, has_networks=explorer.novelty is not None, seed=seed),
        *_make_embedding(explorer),
        *reward.make_transforms(num_envs=envs, seed=seed),
        PreviousAction(world.spec.num_actions),
        *_make_truth(world),
        PreviousReward(in_keys=[reward.reward_key]),
        *([StaggeredEpisodes(world.episode_length)] if stagger else []),
        InitTracker(),
        StepCounter(),
        explorer.policy.make_tensordict_primer(),
    ]
    return TransformedEnv(env, Compose(*transforms))


def _make_views(
    settings: ExploreConfig, *, has_networks: bool, seed: int
) -> list[Transform]:
    """Noise, the policy's copy, and the networks' copy."""
    views: list[Transform] = []
    if settings.collect.noisy_tv:
        views.append(NoisyTV(seed=seed))
    if settings.policy.input == "pixels":
        size = settings.policy.view_size
        views.append(PolicyPixels(size=(size, size)))
    if has_networks:
        factor = 2 if settings.model.halve else 1
        views.append(AreaDownsample(factor=factor))
    return views


def _make_embedding(explorer: Explorer) -> list[Transform]:
    """The embedding, for policy and map, if the reward method does not write it."""
    if explorer.novelty is None or explorer.reward.embeds:
        return []
    return [EmbedViews(explorer.novelty.tc.embed)]


def _make_truth(world: World) -> list[Transform]:
    layout = world.layout
    if layout is None:
        return []
    slots = list(layout.slots.values())
    mask = torch.as_tensor(layout.open_mask)
    return [Coverage(mask, COVERAGE_LEVELS, slot_cells=slots)]
