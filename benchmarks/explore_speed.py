"""Speed of exploration all in, against a roof made of its parts in the same run.

    python benchmarks/explore_speed.py --out results/explore_speed.json
    python benchmarks/explore_speed.py --profile resnet18 --out results/resnet18.json
    python benchmarks/explore_speed.py --device cuda collect.envs=512

The loop of ``recipes/explore.py`` runs for a while: other processes act with the policy
and look every view up in the memory, and this one learns. Then each part is
timed alone, on one thread: a decision of the engines, embedding a view, comparing it
with the memory, a decision of the policy, learning from it. The roof is what all cores
would do if they did nothing else and never waited for each other:
``cores / (sum of the parts)``.

With ``--device cuda`` all but the engines is on the GPU, of which there is one. What is
timed there is waited for, and copying full views to it is a part, too. Cores and GPU
can work at the same time: the roof is that of the one that is full first.

- ``laptop``: the small networks, the policy on the embedding, PPO; about 25 waypoints,
  as at the threshold for rewards. Target 1,000 decisions/s on two quiet cores.
- ``resnet18``: the paper's network, 8 mazes, a full memory of 200. Target 0.7 of the
  roof.

The networks are untrained: that changes no shape. A threshold of almost 1 makes every
view novel, so that the memory fills up at once and stays at the profile's size. Times
of parts are the best of several windows; the ratio and the shares are of the mean rate
all in, and the best window's is beside it. The load average says how far to trust them.
"""

import argparse
import json
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from tensordict import TensorDictBase

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
    """The shortest time of a call, until its device has done all of it."""
    call()
    best = float("inf")
    for _ in range(windows):
        settle(device)
        start = time.perf_counter()
        call()
        settle(device)
        best = min(best, time.perf_counter() - start)
    return best


def settle(device: torch.device) -> None:
    """Wait until a device has done what it was asked for."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def places_of(settings: ExploreConfig) -> dict[str, torch.device]:
    """Where each part is computed."""
    there = make_device(settings.collect_device)
    places = dict.fromkeys(("policy", "embed", "compare", "transfer"), there)
    if there == CPU:
        del places["transfer"]
    return {"engines": CPU, **places, "learn": make_device(settings.device)}


def against_roof(
    parts: Mapping[str, float],
    places: Mapping[str, torch.device],
    mean: float,
    cores: int,
) -> dict[str, Any]:
    """A mean rate in decisions/s against that of cores and devices that never wait."""
    number = {name: cores if places[name] == CPU else 1 for name in parts}
    each = {name: seconds / number[name] for name, seconds in parts.items()}
    of_cores = [name for name in parts if places[name] == CPU]
    elsewhere = [name for name in parts if places[name] != CPU]
    busy = [sum(each[n] for n in parts if places[n] == one) for one in places.values()]
    shares = {name: each[name] * mean for name in of_cores}
    shares["rest"] = 1 - sum(shares.values())
    return {
        "roof": 1 / max(busy),
        "ratio": mean * max(busy),
        "milliseconds_of_a_core": {name: 1e3 * parts[name] for name in of_cores},
        "milliseconds_elsewhere": {name: 1e3 * parts[name] for name in elsewhere},
        "shares": shares,
        "shares_elsewhere": {name: each[name] * mean for name in elsewhere},
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
    try:
        for _ in range(2 * per_window):  # the memories fill up
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
def time_env(world: World, envs: int) -> float:
    """Seconds of the engines' cores for a decision: they draw on other threads."""
    env = world.make_env(batch_size=envs, seed=0, privileged=world.spec.has_truth)
    now = env.reset()
    action = torch.zeros(envs, dtype=torch.int64)
    seconds = best_seconds(lambda: env.step(now.set("action", action)), 50)
    env.close()
    return seconds / envs


@torch.no_grad()
def time_decision(
    settings: ExploreConfig, world: World, explorer: Explorer, envs: int
) -> dict[str, float]:
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
    seconds = {
        name: best_seconds(call, windows.get(name, WINDOWS), device) / envs
        for name, call in calls.items()
    }
    env.close()
    return seconds


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
    parts = {"engines": time_env(world, envs)}
    parts |= time_decision(settings, world, explorer, envs)
    learn = best_seconds(lambda: learner.extend(batch.clone()), 4, learner.device)
    parts["learn"] = learn / batch.numel()
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
        **against_roof(parts, places_of(settings), mean, cores),
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
