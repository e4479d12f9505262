"""The processes that explore, and how they get their weights."""

from collections.abc import Collection, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey
from torch import nn
from torchrl.collectors import BaseCollector, Collector, MultiSyncCollector
from torchrl.envs import EnvBase
from torchrl.envs.transforms import ExcludeTransform
from torchrl.weight_update import NoWeightSyncScheme

from toponav.builders import (
    NETWORKS,
    POLICY,
    Consumer,
    World,
    keep_freed_memory,
    make_empty_novelty,
    seed_of,
)
from toponav.collectors import (
    Mailbox,
    MailboxCollector,
    PatientAsyncCollector,
    Subscription,
)
from toponav.config import ExploreConfig
from toponav.keys import PIXELS
from toponav.methods import LEARNERS, make_reward
from toponav.training.explorer import Explorer, make_explore_env, make_explorer


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


def make_explore_collector(
    settings: ExploreConfig,
    world: World,
    mailbox: Mailbox,
    *,
    keep: Sequence[NestedKey],
    decisions: int = 0,
) -> BaseCollector:
    """Processes that explore with the weights in a mailbox of `Explorer.modules`.

    Each hands over batches ``[E, T]`` with the keys ``keep``, with
    ``collect.mode=async`` while the caller learns from the last one; it then is at most
    two batches behind the newest weights. With ``sync`` all wait for the caller and
    hand over one batch together. If an earlier part of the run made ``decisions``, its
    episodes do not come again.

    Iterate with `collect_batches`; end it in ``finally`` with `stop_collector`; never
    ask it for its state while it runs (it would drop a rollout and hang).

    Raises:
        EngineError: if the engine cannot start.
        CollectionError: if a process dies or hangs while it starts.
    """
    collect = settings.collect
    arguments: dict[str, Any] = {
        "create_env_fn": [make_worker_env] * collect.workers,
        "policy_factory": partial(
            LEARNERS[settings.loss.name].make_policy, settings, world
        ),
        "total_frames": -1,
        "use_buffers": True,
        "num_threads": torch.get_num_threads(),
        "weight_sync_schemes": {POLICY: NoWeightSyncScheme()},
        "auto_register_policy_transforms": False,
        "collector_class": partial(
            make_worker_collector,
            settings=settings,
            world=world,
            mailbox=mailbox,
            keep=keep,
            decisions=decisions,
        ),
    }
    frames = collect.envs * settings.loss.rollout
    if collect.mode == "sync":
        return MultiSyncCollector(frames_per_batch=frames, cat_results=0, **arguments)
    frames //= collect.workers
    return PatientAsyncCollector(frames_per_batch=frames, **arguments)


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
    worker_idx: int,
    create_env_kwargs: dict[str, Any] | None = None,
    **kwargs: Any,
) -> MailboxCollector:
    """The collector of one process, built there, with its own copies of the networks.

    They are filled before the environment looks through them for the first time.
    """
    # One process, one core: threads of torch would only get in each other's way.
    torch.set_num_threads(1)
    keep_freed_memory()
    seed = seed_of(settings.seed, decisions, worker_idx)
    torch.manual_seed(seed)
    policy = LEARNERS[settings.loss.name].make_policy(settings, world)
    explorer = make_explorer(policy, make_reward(settings, world, None), None)
    if explorer.novelty is None and NETWORKS in mailbox.names:
        explorer.novelty = make_empty_novelty(settings.model, world.spec)
    for name, module in explorer.modules().items():
        mailbox.pull(name, module)
    return MailboxCollector(
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


def _subscriptions(explorer: Explorer) -> list[Subscription]:
    """What a collecting process fetches before each rollout."""

    def find(name: str, collector: Collector) -> nn.Module:
        return collector.policy if name == POLICY else explorer.modules()[name]

    def refresh(collector: Collector) -> None:
        for transform in collector.env.transform:
            if hasattr(transform, "refresh"):
                assert explorer.novelty is not None
                transform.refresh(float(explorer.novelty.threshold))

    return [
        Subscription(
            name,
            ("version", name),
            partial(find, name),
            refresh if name == NETWORKS else None,
        )
        for name in explorer.modules()
    ]
