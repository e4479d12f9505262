"""Speed of exploration all in, against a roof made of its parts in the same run.

    python benchmarks/explore_speed.py --out results/explore_speed.json
    python benchmarks/explore_speed.py --profile resnet18 --out results/resnet18.json
    python benchmarks/explore_speed.py --device cuda collect.workers=8 collect.envs=512

The loop of ``recipes/explore.py`` runs for a while: other processes act with the policy
and look every view up in the memory, and this one learns. Then each part is
timed alone, on one thread: a decision of the engines (and of the process that drives
them), embedding a view, comparing it with the memory, a decision of the policy,
learning from it. The roof is what would be done if nothing else were and nobody waited:
by all cores, ``cores / (sum of the parts)``, or by the learner, which is one thread of
one process, whichever is full first.

With ``--device cuda`` all but the engines is on the GPU, of which there is one, and
copying full views to it is a part, too. Then a part is the time that its core needs to
ask the GPU for it, and what the GPU computes and copies meanwhile is taken from
torch's profiler; its kernels and its copies have roofs of their own.

- ``laptop``: the small networks, the policy on the embedding, PPO; about 25 waypoints,
  as at the threshold for rewards. Target 1,000 decisions/s on two quiet cores.
- ``resnet18``: the paper's network, 8 mazes, a full memory of 200. Target 0.7 of the
  roof.

The networks are untrained: that changes no shape. A threshold of almost 1 makes every
view novel, so that the memory fills up at once and stays at the profile's size. Times
of parts, but for the engines', are the best of several windows; the ratio and the
shares are of the mean rate all in, and the best window's is beside it. The load average
says how far to trust them.
"""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import psutil
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from tensordict import TensorDictBase
from torch.profiler import ProfilerActivity, profile

from toponav.builders import (
    World,
    collect_batches,
    has_fast_bf16,
    make_device,
    make_networks,
    prepare_process,
    stop_collector,
)
from toponav.config import ExploreConfig
from toponav.keys import NETWORK_PIXELS, PIXELS
from toponav.methods import (
    LEARNERS,
    ActorCriticLearner,
    make_reward,
    make_world,
    register,
)
from toponav.training import (
    EpisodeLog,
    Explorer,
    make_explore_collector,
    make_explore_env,
    make_explorer,
    make_mailbox,
    needed_keys,
    publish,
)

CONF = Path(__file__).resolve().parent.parent / "conf"
PROFILES = {
    "laptop": ["scale=laptop", "reward.capacity=25"],
    "resnet18": [
        "scale=paper",
        "policy.input=embedding",
        "online.learn=false",
        "collect.envs=8",
        "collect.workers=2",
        "reward.capacity=200",
    ],
}
ALWAYS_NOVEL = ["reward.threshold=0.999", "reward.persistence=1"]
WINDOWS = 12
CPU = torch.device("cpu")
LIMITS = ("ATEN_CPU_CAPABILITY", "ONEDNN_MAX_CPU_ISA", "MKL_ENABLE_INSTRUCTIONS")


def compose_settings(recipe: str, words: list[str]) -> Any:
    """Settings of a recipe by a command line."""
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return OmegaConf.to_object(compose(recipe, overrides=words))


def make_settings(profile: str, overrides: list[str]) -> ExploreConfig:
    """Settings of a profile."""
    words = [*PROFILES[profile], *ALWAYS_NOVEL, *overrides]
    settings = compose_settings("explore", words)
    assert isinstance(settings, ExploreConfig)
    return settings.resolved(settings.model)


def best_seconds(
    call: Callable[[], object], windows: int = WINDOWS, device: torch.device = CPU
) -> float:
    """The shortest time of a call of a core, with nothing else asked of its device."""
    call()
    best = float("inf")
    for _ in range(windows):
        settle(device)
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return best


def device_seconds(
    call: Callable[[], object], device: torch.device, calls: int = 4
) -> dict[str, float]:
    """Seconds of a GPU for a call: of its kernels, and of copies from and to it."""
    if device.type != "cuda":
        return {}
    with profile(activities=[ProfilerActivity.CUDA]) as watched:
        for _ in range(calls):
            call()
        settle(device)
    spent = {"kernels": 0.0, "copies": 0.0}
    for event in watched.key_averages():
        # Copies within the device are made by its cores, as kernels are.
        copied = event.key.startswith(("Memcpy HtoD", "Memcpy DtoH"))
        spent["copies" if copied else "kernels"] += event.self_device_time_total
    return {name: 1e-6 * total / calls for name, total in spent.items()}


def time_call(
    call: Callable[[], object],
    decisions: int,
    device: torch.device,
    windows: int = WINDOWS,
) -> dict[str, float]:
    """Seconds that a core and the device need for one of the decisions of a call."""
    found = {"core": best_seconds(call, windows, device)}
    found |= device_seconds(call, device)
    return {name: seconds / decisions for name, seconds in found.items()}


def settle(device: torch.device) -> None:
    """Wait until a device has done what it was asked for."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def against_roof(
    parts: Mapping[str, Mapping[str, float]], mean: float, cores: int
) -> dict[str, Any]:
    """A mean rate in decisions/s against what is full first, and how full all is.

    ``parts`` are seconds for a decision: ``core`` of one core, ``kernels`` and
    ``copies`` of a GPU.
    """
    seconds = {
        where: {name: part[where] for name, part in parts.items() if part.get(where)}
        for where in ("core", "kernels", "copies")
    }
    busy = {
        "cores": sum(seconds["core"].values()) / cores,
        "learner": parts["learn"]["core"],
        "kernels": sum(seconds["kernels"].values()),
        "copies": sum(seconds["copies"].values()),
    }
    first = max(busy, key=lambda name: busy[name])
    shares = {name: one * mean / cores for name, one in seconds["core"].items()}
    shares["rest"] = 1 - sum(shares.values())
    return {
        "roof": 1 / busy[first],
        "full_first": first,
        "ratio": mean * busy[first],
        "roofs": {name: 1 / one for name, one in busy.items() if one},
        "milliseconds_of_a_core": {n: 1e3 * one for n, one in seconds["core"].items()},
        "shares": shares,
        "milliseconds_of_the_gpu": {
            where: {name: 1e3 * one for name, one in seconds[where].items()}
            for where in ("kernels", "copies")
            if seconds[where]
        },
    }


def run_all_in(
    settings: ExploreConfig,
    world: World,
    explorer: Explorer,
    learner: ActorCriticLearner,
    seconds: float,
) -> tuple[float, float, TensorDictBase]:
    """Explore and learn; the best and the mean rate, and the last batch."""
    mailbox = make_mailbox(settings, explorer, {})
    # Batches hold what the log of a run reads too, as in the recipe.
    log = EpisodeLog(settings.collect.envs, world, explorer.reward)
    keep = needed_keys({"episodes": log, "learner": learner, "reward": explorer.reward})
    collector = make_explore_collector(settings, world, mailbox, keep=keep)
    batches = collect_batches(collector, max_idle_s=settings.collect.max_idle_s)
    # One window is a few batches: single ones come in bursts.
    per_window, rates, done = 2 * settings.collect.workers, [], 0
    to_fill = math.ceil(settings.reward.capacity / settings.loss.rollout)
    try:
        # Two for what is slow at first, or until the memories are full.
        for _ in range(settings.collect.workers * max(2, to_fill)):
            batch = next(batches)
        end = time.perf_counter() + seconds
        began = time.perf_counter()
        while time.perf_counter() < end:
            start = time.perf_counter()
            for _ in range(per_window):
                batch = next(batches)
                learner.extend(batch.clone())
                publish(mailbox, explorer, [learner])
            done += per_window * batch.numel()
            rates.append(per_window * batch.numel() / (time.perf_counter() - start))
        mean = done / (time.perf_counter() - began)
    finally:
        stop_collector(collector)
    return max(rates), mean, batch


@torch.no_grad()
def time_env(world: World, envs: int, steps: int = 200) -> float:
    """Seconds of a core for a decision of the engines, and of driving them.

    They are processes of their own, of which several draw at a time: it is taken from
    what the system counts for them and for this process.
    """
    env = world.make_env(batch_size=envs, seed=0, privileged=world.spec.has_truth)
    now = env.reset()
    action = torch.zeros(envs, dtype=torch.int64)
    own = psutil.Process()
    processes = [own, *own.children(recursive=True)]

    def spent() -> float:
        return sum(sum(one.cpu_times()[:2]) for one in processes)

    began = spent()
    for _ in range(steps):
        env.step(now.set("action", action))
    seconds = spent() - began
    env.close()
    return seconds / steps / envs


@torch.no_grad()
def time_decision(
    settings: ExploreConfig, world: World, explorer: Explorer, envs: int
) -> dict[str, dict[str, float]]:
    """Seconds of a decision: of the policy, of embedding, comparing and copying views.

    The networks are copies, where and in the precision in which collecting processes
    have them.
    """
    modules, device = explorer.modules(), make_device(settings.collect_device)
    explorer = make_explorer(
        settings,
        world,
        list(modules),
        lambda name, module: module.load_state_dict(modules[name].state_dict()),
        device=device,
    )
    assert explorer.novelty is not None
    tc, policy = explorer.novelty.tc, explorer.policy
    env = make_explore_env(settings, world, explorer, envs=envs, seed=0, device=device)
    now = env.reset()
    calls: dict[str, Callable[[], object]] = {"policy": lambda: policy(now.clone())}
    views = now[NETWORK_PIXELS]
    calls["embed"] = lambda: tc.embed(views)
    memory = torch.randn(envs, settings.reward.capacity, settings.model.embedding_dim)
    memory = memory.to(next(tc.parameters()))
    prepared, one = tc.prepare_memory(memory), memory[:, 0]
    calls["compare"] = lambda: tc.compare_prepared(one, prepared)
    full = now[PIXELS].cpu()
    if device != CPU:
        calls["transfer"] = lambda: full.to(device, non_blocking=True)
    windows = {"policy": 50}
    parts = {
        name: time_call(call, envs, device, windows.get(name, WINDOWS))
        for name, call in calls.items()
    }
    env.close()
    return parts


def measure(settings: ExploreConfig, seconds: float) -> dict[str, Any]:
    """Explore for so many seconds, then time the parts, in seconds of their place."""
    envs = settings.collect.envs // settings.collect.workers
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
    best, mean, batch = run_all_in(settings, world, explorer, learner, seconds)
    print(f"{mean:.0f} decisions/s all in; timing the parts", file=sys.stderr)
    parts = {"engines": {"core": time_env(world, envs)}}
    parts |= time_decision(settings, world, explorer, envs)
    learn = partial(learner.extend, batch.clone())
    parts["learn"] = time_call(learn, batch.numel(), learner.device, windows=4)
    return {"best": best, "mean": mean, "parts": parts}


def main() -> None:
    """Measure one profile and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--profile", choices=PROFILES, default="laptop")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--device", default="cpu", help="cpu, cuda, cuda:1, ...")
    parser.add_argument("--out", type=Path)
    parser.add_argument("overrides", nargs="*", help="more settings, as for the recipe")
    arguments = parser.parse_args()
    prepare_process(threads=1)
    words = [f"device={arguments.device}", *arguments.overrides]
    settings = make_settings(arguments.profile, words)
    found = measure(settings, arguments.seconds)
    best, mean, parts = found["best"], found["mean"], found["parts"]
    cores = len(os.sched_getaffinity(0))
    found = {
        "profile": arguments.profile,
        "overrides": arguments.overrides,
        "decisions_per_second": best,
        "mean_decisions_per_second": mean,
        **against_roof(parts, mean, cores),
        "device": arguments.device,
        "collect_device": settings.collect_device,
        # By which a processor computes like an older one.
        "limits": {name: os.environ[name] for name in LIMITS if name in os.environ},
        "bf16": has_fast_bf16(make_device(settings.collect_device)),
        "cores": cores,
        "load": os.getloadavg()[0],
    }
    print(json.dumps(found, indent=2))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
