"""The processes in which an explorer explores: on this machine, or by Ray on many."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey
from torchrl.collectors import BaseCollector, MultiSyncCollector
from torchrl.weight_update import NoWeightSyncScheme

from toponav.builders import POLICY, World, join_cluster, start_collector
from toponav.collectors import (
    LastingRayCollector,
    Mailbox,
    PatientAsyncCollector,
    PreparedCollector,
    RayMailbox,
)
from toponav.config import ExploreCollectConfig, ExploreConfig, require
from toponav.training.explore_worker import (
    make_worker_env,
    make_worker_policy,
    prepare_worker,
)
from toponav.training.explorer import Explorer


def make_mailbox(
    settings: ExploreConfig, explorer: Explorer, versions: Mapping[str, int]
) -> Mailbox | RayMailbox:
    """Where collecting processes find the explorer's weights, numbered on.

    With ``collect.backend=ray`` this process joins the cluster.

    Raises:
        SettingsError: if there is none, or it has too few cores.
    """
    if settings.collect.backend == "local":
        return Mailbox(explorer.modules(), versions=versions)
    join_cluster(settings.ray.address, workers=settings.collect.workers)
    return RayMailbox(explorer.modules(), versions=versions)


def make_explore_collector(
    settings: ExploreConfig,
    world: World,
    mailbox: Mailbox | RayMailbox,
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
        SettingsError: if the episodes are of other processes or mazes than there are.
        EngineError: if the engine cannot start.
        CollectionError: if a process dies or hangs while it starts.
    """
    collect = settings.collect
    if episodes is not None:
        _require_same_processes(collect, episodes)
    prepare = partial(
        prepare_worker,
        settings=settings,
        world=world,
        mailbox=mailbox,
        keep=keep,
        decisions=decisions,
    )
    policy = partial(make_worker_policy, settings, world)
    frames = collect.envs * settings.loss.rollout
    if collect.mode == "async":
        frames //= collect.workers
    arguments: dict[str, Any] = {
        "create_env_fn": [make_worker_env] * collect.workers,
        "policy_factory": policy,
        "frames_per_batch": frames,
        "total_frames": -1,
    }
    shared = {"use_buffers": True, "auto_register_policy_transforms": False}
    make: Callable[..., BaseCollector]
    if collect.backend == "ray":
        own: Sequence[Mapping[str, Any] | None]
        own = [None] * collect.workers if episodes is None else episodes
        each = [{"prepare": prepare, "episodes": one, **shared} for one in own]
        make = partial(
            LastingRayCollector,
            collector_kwargs=each,
            sync=collect.mode == "sync",
            max_idle_s=collect.max_idle_s,
        )
    else:
        arguments |= {
            "num_threads": torch.get_num_threads(),
            "weight_sync_schemes": {POLICY: NoWeightSyncScheme()},
            "collector_class": partial(_continued, prepare=prepare, episodes=episodes),
            **shared,
        }
        if collect.mode == "sync":
            make = partial(MultiSyncCollector, cat_results=0)
        else:
            make = PatientAsyncCollector
    return start_collector(partial(make, **arguments), max_idle_s=collect.max_idle_s)


def _require_same_processes(
    collect: ExploreCollectConfig, episodes: Sequence[Mapping[str, Any]]
) -> None:
    """Refuse other numbers of processes and mazes than episodes come from."""
    mazes = sum(len(one["games"]["begun"]) for one in episodes)
    given = {"workers": len(episodes), "envs": mazes}
    for name, number in given.items():
        rule = f"collect.{name} must stay {number} where episodes are resumed"
        found = getattr(collect, name)
        require(found == number, f"{rule} (collect.mode=sync)", found)


def _continued(
    *arguments: Any,
    worker_idx: int,
    episodes: Sequence[Mapping[str, Any]] | None,
    **kwargs: Any,
) -> PreparedCollector:
    """The collector of one process of this machine, with its share of the episodes."""
    own = None if episodes is None else episodes[worker_idx]
    return PreparedCollector(*arguments, worker_idx=worker_idx, episodes=own, **kwargs)
