"""What collecting by Ray costs beside collecting: batches and weights on their way.

    python benchmarks/ray_parts.py --out results/ray_parts.json
    python benchmarks/ray_parts.py --profile resnet18 --address <host>:6379

Without an address a cluster is started on this machine, and what is timed is Ray's own
work: writing and reading, no network between machines. A batch is one of a collecting
process of ``benchmarks/explore_speed.py``; an actor hands copies of it over, as a
process does when it has made one. Weights are published to a `RayMailbox` and read from
it. Times are medians, in milliseconds: ``wall`` as they passed, which other programs
prolong, and ``cpu`` of this process alone.
"""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch
from explore_speed import PROFILES, make_settings
from tensordict import TensorDictBase
from torch import nn

from toponav.builders import join_cluster, make_networks, prepare_process
from toponav.collectors import Mailbox, PreparedCollector, RayMailbox
from toponav.config import ExploreConfig
from toponav.methods import LEARNERS, make_reward, make_world
from toponav.training import (
    EpisodeLog,
    Explorer,
    make_worker_env,
    needed_keys,
    prepare_worker,
)

try:
    import ray
except ImportError:  # main says so
    ray = None

REPEATS = 30


class Sender:
    """Hands over a batch as often as it is asked for it."""

    def __init__(self, batch: TensorDictBase) -> None:
        self.batch = batch

    def next(self) -> TensorDictBase:
        return self.batch.copy()


def milliseconds(call: Callable[[], object]) -> dict[str, float]:
    """Median time of a call and of this process's part of it."""
    walls, cpus = [], []
    call()
    for _ in range(REPEATS):
        wall, cpu = time.perf_counter(), time.process_time()
        call()
        walls.append(1e3 * (time.perf_counter() - wall))
        cpus.append(1e3 * (time.process_time() - cpu))
    return {"wall": statistics.median(walls), "cpu": statistics.median(cpus)}


def make_parts(settings: ExploreConfig) -> tuple[TensorDictBase, dict[str, nn.Module]]:
    """A batch as it is handed over, and what is published."""
    world = make_world(settings)
    networks = make_networks(settings.model, world.spec)
    networks.modules.eval()
    reward = make_reward(settings, world, networks)
    learner = LEARNERS[settings.loss.name](
        settings,
        world,
        reward=reward.reward_key,
        check=lambda figures, update: None,
        progress=lambda: 0.0,
    )
    explorer = Explorer(learner.policy, reward, networks)
    log = EpisodeLog(settings.collect.envs, world, reward)
    prepare = partial(
        prepare_worker,
        settings=settings,
        world=world,
        mailbox=Mailbox(explorer.modules()),
        keep=needed_keys({"episodes": log, "learner": learner, "reward": reward}),
        decisions=0,
    )
    envs = settings.collect.envs // settings.collect.workers
    collector = PreparedCollector(
        make_worker_env,
        prepare=prepare,
        worker_idx=0,
        policy_factory=partial(
            LEARNERS[settings.loss.name].make_policy, settings, world
        ),
        frames_per_batch=envs * settings.loss.rollout,
        total_frames=-1,
        use_buffers=True,
        auto_register_policy_transforms=False,
    )
    try:
        return collector.rollout().clone(), explorer.modules()
    finally:
        collector.shutdown()


def measure(settings: ExploreConfig, address: str | None) -> dict[str, Any]:
    """Sizes in bytes and times in milliseconds."""
    batch, modules = make_parts(settings)
    join_cluster(address, workers=1)
    try:
        sender = ray.remote(num_cpus=1)(Sender).remote(batch)
        mailbox = RayMailbox(modules)
        found: dict[str, Any] = {
            "decisions_of_a_batch": batch.numel(),
            "bytes_of_a_batch": batch.bytes(),
            "bytes_sent": len(ray.cloudpickle.dumps(batch)),
            "batch": milliseconds(lambda: ray.get(sender.next.remote())),
            "question": milliseconds(lambda: mailbox.version("policy")),
        }
        for name, module in modules.items():
            size = sum(one.nbytes for one in module.state_dict().values())
            found[name] = {
                "bytes": size,
                "publish": milliseconds(partial(mailbox.publish, name, module)),
                "pull": milliseconds(partial(mailbox.pull, name, module)),
            }
    finally:
        ray.shutdown()
    return found


def main() -> None:
    """Measure one profile and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--profile", choices=PROFILES, default="laptop")
    parser.add_argument("--address", help="of a cluster, <host>:<port>")
    parser.add_argument("--out", type=Path)
    parser.add_argument("overrides", nargs="*", help="more settings, as for the recipe")
    arguments = parser.parse_args()
    if ray is None:
        parser.error("Ray must be installed: pip install 'toponav[ray]'")
    prepare_process(threads=1)
    torch.manual_seed(0)
    settings = make_settings(arguments.profile, arguments.overrides)
    found = {
        "profile": arguments.profile,
        "overrides": arguments.overrides,
        **measure(settings, arguments.address),
        "load": os.getloadavg()[0],
    }
    print(json.dumps(found, indent=2))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
