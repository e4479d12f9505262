"""One collecting process: its networks, its environments, what it reads."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import EnvBase
from torchrl.envs.transforms import ExcludeTransform

from toponav.builders import (
    NETWORKS,
    POLICY,
    World,
    make_device,
    prepare_process,
    seed_of,
)
from toponav.collectors import Mailbox, RayMailbox, Subscription
from toponav.config import ExploreConfig
from toponav.keys import EMBEDDING, NETWORK_PIXELS, PIXELS
from toponav.methods import LEARNERS
from toponav.training.explorer import Explorer, make_explore_env, make_explorer


def make_worker_env(settings: ExploreConfig, **arguments: Any) -> EnvBase:
    """The environment of one collecting process; full views stay out of batches."""
    stagger = settings.collect.stagger
    env = make_explore_env(settings, stagger=stagger, teach=True, **arguments)
    return env.append_transform(ExcludeTransform(PIXELS))


def make_worker_policy(settings: ExploreConfig, world: World) -> TensorDictModuleBase:
    """The policy of one collecting process, to be filled."""
    policy = LEARNERS[settings.loss.name].make_policy(settings, world)
    return policy.to(make_device(settings.collect_device, "collect.device"))


def prepare_worker(
    worker_idx: int,
    start: int = 0,
    *,
    settings: ExploreConfig,
    world: World,
    mailbox: Mailbox | RayMailbox,
    keep: Sequence[NestedKey] | None,
    decisions: int,
) -> dict[str, Any]:
    """What the collector of one process is made of, with networks of its own.

    They are filled before the environment looks through them for the first time. It is
    called in that process; ``start`` counts those that had its number and died, whose
    episodes are not played again.
    """
    # One process, one core: threads of torch would only get in each other's way.
    again = (start,) if start else ()
    seed = seed_of(settings.seed, decisions, worker_idx, *again)
    prepare_process(threads=1, seed=seed)
    device = make_device(settings.collect_device, "collect.device")
    versions: dict[str, int] = {}

    def fill(name: str, module: nn.Module) -> None:
        versions[name] = mailbox.pull(name, module)

    explorer = make_explorer(settings, world, mailbox.names, fill, device=device)
    # The policy that acts is the collector's own, which its first rollout fills.
    del versions[POLICY]
    return {
        # All of a rollout is there; what leaves this process is copied at its end.
        "device": device,
        # Or TorchRL takes a stream of a GPU that waits for nothing done before it, such
        # as these weights.
        "no_cuda_sync": True,
        "create_env_kwargs": {
            "settings": settings,
            "world": world,
            "explorer": explorer,
            "envs": settings.collect.envs // settings.collect.workers,
            "seed": seed,
            "device": device,
        },
        "mailbox": mailbox,
        "subscriptions": _subscriptions(explorer),
        "versions": versions,
        "keep": keep,
    }


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
