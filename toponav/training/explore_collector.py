"""The explorer, its environments, and the processes in which it explores."""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.collectors import BaseCollector, Collector, MultiSyncCollector
from torchrl.envs import Compose, EnvBase, InitTracker, StepCounter, TransformedEnv
from torchrl.envs.transforms import ExcludeTransform, Transform
from torchrl.weight_update import NoWeightSyncScheme

from toponav.builders import (
    NETWORKS,
    POLICY,
    Consumer,
    Networks,
    Novelty,
    RewardMethod,
    World,
    make_empty_novelty,
    prepare_process,
    seed_of,
    start_collector,
)
from toponav.collectors import (
    Mailbox,
    MailboxCollector,
    PatientAsyncCollector,
    StaggeredEpisodes,
    Subscription,
)
from toponav.config import ExploreConfig
from toponav.keys import EMBEDDING, NETWORK_PIXELS, PIXELS
from toponav.methods import LEARNERS, make_reward
from toponav.transforms import (
    AreaDownsample,
    Coverage,
    EmbedViews,
    NoisyTV,
    PlacesVisited,
    PolicyPixels,
    PreviousAction,
    PreviousReward,
)

#: Levels of coverage whose decisions are recorded.
COVERAGE_LEVELS = (0.5, 0.9, 1.0)


class Explorer:
    """A policy, its reward method, and the TC-network if the run has one.

    A reward method with a TC-network of its own shares that.
    """

    def __init__(
        self,
        policy: TensorDictModuleBase,
        reward: RewardMethod,
        networks: Networks | None,
    ) -> None:
        self.policy = policy
        self.reward = reward
        #: Embeds views, for the policy and the map.
        self.novelty = reward.novelty
        if self.novelty is None and networks is not None:
            self.novelty = Novelty(networks.tc)

    def modules(self) -> dict[str, nn.Module]:
        """All that collecting processes fetch, by the name it is published under."""
        networks = {} if self.novelty is None else {NETWORKS: self.novelty}
        return {POLICY: self.policy, **networks, **self.reward.modules()}


def publish(
    mailbox: Mailbox, explorer: Explorer, consumers: Collection[Consumer]
) -> dict[str, int]:
    """Publish what consumers have updated; the new versions, which all of them get."""
    names = {name for one in consumers for name in one.updated()}
    versions = {
        name: mailbox.publish(name, module)
        for name, module in explorer.modules().items()
        if name in names
    }
    for one in consumers:
        one.refresh(versions)
    return versions


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
    network reads a privileged key. The explorer's networks must be in ``eval()`` mode.
    ``stagger`` cuts the first episodes at different lengths.

    Raises:
        SettingsError: if the settings do not fit the world.
        EngineError: if the engine cannot start.
    """
    env = world.make_env(
        batch_size=envs, seed=seed, privileged=world.spec.has_positions
    )
    reward, novelty = explorer.reward, explorer.novelty
    transforms: list[Transform] = []
    # The views: with noise if it is wanted, the policy's copy, the networks' copy.
    if settings.collect.noisy_tv:
        transforms.append(NoisyTV(seed=seed))
    if settings.policy.input == "pixels":
        transforms.append(PolicyPixels(size=(settings.policy.view_size,) * 2))
    if novelty is not None:
        transforms.append(AreaDownsample(factor=2 if settings.model.halve else 1))
        if not reward.embeds:
            transforms.append(EmbedViews(novelty.tc.embed))
    transforms += reward.make_transforms(num_envs=envs, seed=seed)
    transforms.append(PreviousAction(world.spec.num_actions))
    if world.layout is not None:
        transforms.append(make_coverage(world))
    elif world.spec.place_size is not None:
        transforms.append(PlacesVisited(world.spec.place_size))
    transforms.append(PreviousReward(in_keys=[reward.reward_key]))
    if stagger:
        transforms.append(StaggeredEpisodes(world.episode_length))
    transforms += [InitTracker(), StepCounter()]
    if hasattr(explorer.policy, "make_tensordict_primer"):
        transforms.append(explorer.policy.make_tensordict_primer())
    return TransformedEnv(env, Compose(*transforms))


def make_coverage(world: World) -> Coverage:
    """What measures coverage in a maze."""
    assert world.layout is not None
    slots = list(world.layout.slots.values())
    mask = torch.as_tensor(world.layout.open_mask)
    return Coverage(mask, COVERAGE_LEVELS, slot_cells=slots)


def make_explore_collector(
    settings: ExploreConfig,
    world: World,
    mailbox: Mailbox,
    *,
    keep: Sequence[NestedKey],
    decisions: int = 0,
    episodes: Sequence[Mapping[str, Any]] | None = None,
) -> BaseCollector:
    """Processes that explore with the weights in a mailbox of `Explorer.modules`.

    Each hands over batches ``[E, T]`` with the keys ``keep``, with
    ``collect.mode=async`` while the caller learns from the last one; it then is at most
    two batches behind the newest weights. With ``sync`` all wait for the caller and
    hand over one batch together. If an earlier part of the run made ``decisions``, it
    resumes their ``episodes`` (from `running_episodes`) or starts new ones.

    Iterate with `collect_batches`; end it in ``finally`` with `stop_collector`; never
    ask it for TorchRL's state while it runs (it would drop a rollout and hang).

    Raises:
        EngineError: if the engine cannot start.
        CollectionError: if a process dies or hangs while it starts.
    """
    collect = settings.collect
    make_collector = partial(
        make_worker_collector,
        settings=settings,
        world=world,
        mailbox=mailbox,
        keep=keep,
        decisions=decisions,
        episodes=episodes,
    )
    policy = partial(LEARNERS[settings.loss.name].make_policy, settings, world)
    arguments: dict[str, Any] = {
        "create_env_fn": [make_worker_env] * collect.workers,
        "policy_factory": policy,
        "total_frames": -1,
        "use_buffers": True,
        "num_threads": torch.get_num_threads(),
        "weight_sync_schemes": {POLICY: NoWeightSyncScheme()},
        "auto_register_policy_transforms": False,
        "collector_class": make_collector,
    }
    frames = collect.envs * settings.loss.rollout
    make: Callable[..., BaseCollector]
    if collect.mode == "sync":
        make = partial(MultiSyncCollector, cat_results=0)
    else:
        make, frames = PatientAsyncCollector, frames // collect.workers
    start = partial(make, frames_per_batch=frames, **arguments)
    return start_collector(start, max_idle_s=collect.max_idle_s)


def make_worker_env(settings: ExploreConfig, **arguments: Any) -> EnvBase:
    """The environment of one collecting process; full views stay out of batches."""
    stagger = settings.collect.stagger
    env = make_explore_env(settings, stagger=stagger, **arguments)
    return env.append_transform(ExcludeTransform(PIXELS))


def make_worker_collector(
    create_env_fn: Any,
    *,
    settings: ExploreConfig,
    world: World,
    mailbox: Mailbox,
    decisions: int,
    episodes: Sequence[Mapping[str, Any]] | None,
    worker_idx: int,
    create_env_kwargs: dict[str, Any] | None = None,
    **kwargs: Any,
) -> MailboxCollector:
    """The collector of one process, built there, with its own copies of the networks.

    They are filled before the environment looks through them for the first time.
    """
    # One process, one core: threads of torch would only get in each other's way.
    seed = seed_of(settings.seed, decisions, worker_idx)
    prepare_process(threads=1, seed=seed)
    policy = LEARNERS[settings.loss.name].make_policy(settings, world)
    explorer = Explorer(policy, make_reward(settings, world, None), None)
    if explorer.novelty is None and NETWORKS in mailbox.names:
        explorer.novelty = make_empty_novelty(settings.model, world.spec)
    for name, module in explorer.modules().items():
        mailbox.pull(name, module)
    collector = MailboxCollector(
        create_env_fn,
        create_env_kwargs={
            "settings": settings,
            "world": world,
            "explorer": explorer,
            "envs": settings.collect.envs // settings.collect.workers,
            "seed": seed,
        },
        worker_idx=worker_idx,
        mailbox=mailbox,
        subscriptions=_subscriptions(explorer),
        **kwargs,
    )
    if episodes is not None:
        collector.resume_episodes(episodes[worker_idx])
    return collector


def _subscriptions(explorer: Explorer) -> list[Subscription]:
    """What a collecting process fetches before each rollout."""

    def find(name: str, collector: Collector) -> nn.Module:
        return collector.policy if name == POLICY else explorer.modules()[name]

    def refresh(collector: Collector) -> None:
        assert explorer.novelty is not None
        for transform in collector.env.transform:
            if hasattr(transform, "refresh"):
                transform.refresh(float(explorer.novelty.threshold))
        # The views with which the rollout begins were embedded after the last one.
        carried = collector._carrier
        with torch.no_grad():
            embedding = explorer.novelty.tc.embed(carried[NETWORK_PIXELS])
        carried[EMBEDDING] = embedding.to(carried[EMBEDDING])

    return [
        Subscription(
            name,
            ("version", name),
            partial(find, name),
            refresh if name == NETWORKS else None,
        )
        for name in explorer.modules()
    ]
