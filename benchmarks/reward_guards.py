"""How each guard of the reward's memory changes what scripted policies are paid.

    python benchmarks/reward_guards.py --networks runs/pretrain/select-... \
        --out x.csv maze=select

Four scripted policies play the same episodes of 1800 decisions: an expert that visits
every cell and then wanders, a sticky and a uniformly random walk, and a *dither* that
only turns left and right on the spot. Their embeddings are recorded, and the memory and
its rewards (alpha 0.2) are computed again for each threshold and each guard. A good
reward pays the expert most and the dither least, and adds few waypoints next to older
ones (spurious waypoints). Rewards are means per episode.
"""

import argparse
import csv
from dataclasses import replace
from itertools import product
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from tqdm import tqdm, trange

from toponav.builders import Networks, World, collect_rollout, load_networks
from toponav.config import ExploreConfig, RewardConfig
from toponav.keys import (
    COVERAGE,
    EMBEDDING,
    HEADING,
    INTRINSIC_REWARD,
    IS_NEW_WAYPOINT,
    POSITION,
    SPURIOUS_WAYPOINT,
)
from toponav.methods import LEARNERS, make_reward, make_world, register
from toponav.policies import (
    FrontierExpert,
    RandomPolicy,
    StickyPolicy,
    forward_weights,
)
from toponav.training import Explorer, make_explore_env
from toponav.transforms import WaypointMemory

CONF = Path(__file__).resolve().parent.parent / "conf"
#: Changes to a memory without guards.
GUARDS = {
    "none": {},
    "persistence 3": {"persistence": 3},
    "min_gap 20": {"min_gap": 20},
    "count on entry": {"count_on": "entry"},
}
#: Where the embeddings are kept, in place of the views.
VIEW = "view"
HEADER = [
    *("maze", "threshold", "similarity", "guard", "walk", "episodes", "coverage"),
    *("intrinsic_return", "new_waypoints", "spurious_waypoints", "return_of_experts"),
]


def make_settings(*words: str, seed: int) -> ExploreConfig:
    """Settings of the laptop scale."""
    register()
    words = (*words, f"seed={seed}")
    with initialize_config_dir(str(CONF), version_base="1.3"):
        settings = OmegaConf.to_object(compose("explore", overrides=list(words)))
    assert isinstance(settings, ExploreConfig)
    return settings


def make_policies(world: World, seed: int) -> dict[str, TensorDictModuleBase]:
    """The four scripted policies, by name, the expert first."""
    spec, layout = world.spec, world.layout
    assert layout is not None  # a maze has a plan
    mask = torch.as_tensor(layout.open_mask)
    forward, number = forward_weights(spec), spec.num_actions
    turns = [float(name in ("left", "right")) for name in spec.actions]
    return {
        "expert": FrontierExpert(mask, world=spec, seed=seed),
        "sticky": StickyPolicy(number, weights=forward, seed=seed),
        "random": RandomPolicy(number, seed=seed),
        "dither": StickyPolicy(number, stickiness=0.0, weights=turns, seed=seed),
    }


@torch.no_grad()
def record(
    settings: ExploreConfig,
    world: World,
    networks: Networks,
    policy: TensorDictModuleBase,
    *,
    episodes: int,
) -> list[TensorDictBase]:
    """Embeddings, poses and coverage of a policy, ``[E]`` for each decision.

    The embeddings have the shape of grey views, ``[E, 1, D, 1]``, for the memory.
    """
    keys = [EMBEDDING, POSITION, HEADING, COVERAGE]
    explorer = Explorer(
        LEARNERS[settings.loss.name].make_policy(settings, world),
        make_reward(settings, world, networks),
        networks,
    )
    env = make_explore_env(settings, world, explorer, envs=episodes, seed=settings.seed)
    try:
        with trange(episodes * world.episode_length, desc="walk", leave=False) as bar:
            played = collect_rollout(
                env, policy, world.episode_length, keep=keys, progress=bar.update
            )
    finally:
        env.close()
    seen = played.frames.unbind(1)
    return [data.set(VIEW, data.pop(EMBEDDING)[:, None, :, None]) for data in seen]


@torch.no_grad()
def compute_rewards(
    settings: ExploreConfig,
    world: World,
    networks: Networks,
    seen: list[TensorDictBase],
) -> tuple[float, Tensor]:
    """The memory's threshold, and what each episode is paid, float32 ``[3, E]``.

    The rows are the intrinsic return, the new waypoints, and the spurious ones
    among them.
    """
    method = make_reward(settings, world, networks)
    config, tc = settings.reward, networks.tc
    threshold = float(method.novelty.threshold)
    memory = WaypointMemory(
        lambda views: views.flatten(1),
        tc.compare_prepared,
        prepare=tc.prepare_memory,
        threshold=threshold,
        persistence=config.persistence,
        min_gap=config.min_gap,
        count_on=config.count_on,
        in_keys=[VIEW],
    )
    # The method's own transforms, but for its memory, which embeds views.
    transforms = method.make_transforms(num_envs=len(seen[0]), seed=settings.seed)
    chain = [memory, *transforms[1:]]
    now = seen[0].clone()
    for transform in chain:
        now = transform._reset(TensorDict(batch_size=now.batch_size), now)
    total = torch.zeros(3, len(now))
    for data in seen[1:]:
        after = data.clone()
        for transform in chain:
            after = transform._step(now, after)
        counted = (INTRINSIC_REWARD, IS_NEW_WAYPOINT, SPURIOUS_WAYPOINT)
        total += torch.stack([after[key].float().squeeze(-1) for key in counted])
        now = after
    return threshold, total


def guarded(config: RewardConfig, changes: dict[str, object]) -> RewardConfig:
    """A memory with these guards and no others."""
    bare = {"persistence": 1, "min_gap": 1, "count_on": "every"}
    return replace(config, **{**bare, **changes})


def main() -> None:
    """Measure, print the table, keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("maze", nargs="+", help="settings of the maze")
    parser.add_argument("--networks", required=True)
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    networks = load_networks(options.networks)
    settings = make_settings(*options.maze, seed=options.seed)
    settings = settings.resolved(networks.model)
    world = make_world(settings)
    recorded = {
        name: record(settings, world, networks, policy, episodes=options.episodes)
        for name, policy in make_policies(world, options.seed).items()
    }
    rows = []
    for word, guard in tqdm(list(product(("auto", "tc"), GUARDS)), desc="guard"):
        config = replace(guarded(settings.reward, GUARDS[guard]), threshold=word)
        changed = replace(settings, reward=config)
        returns = {}
        for name, seen in recorded.items():
            threshold, sums = compute_rewards(changed, world, networks, seen)
            found = sums.mean(1).tolist()
            returns[name] = found[0]
            coverage = float(seen[-1][COVERAGE].mean())
            rows.append(
                [
                    *(world.name, word, round(threshold, 3), guard, name),
                    *(options.episodes, round(coverage, 3)),
                    *(round(value, 2) for value in found),
                    round(found[0] / returns["expert"], 3),
                ]
            )
    for row in [HEADER, *rows]:
        print("{:6} {:9} {:10} {:14} {:7} {:8} {:8} {:16} {:6} {:12} {}".format(*row))
    if options.out:
        with options.out.open("w", newline="") as file:
            csv.writer(file).writerows([HEADER, *rows])


if __name__ == "__main__":
    main()
