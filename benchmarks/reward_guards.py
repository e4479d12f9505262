"""What each guard of the reward's memory does to walks that deserve more or less.

    python benchmarks/reward_guards.py --networks runs/pretrain/maze3-... --out x.csv

Four scripted walks play the same episodes of 1800 decisions: an expert that visits
every cell and then wanders, a sticky and a uniformly random walk, and a *dither* that
only turns to and fro where it stands. Their views are kept, and the memory with its
rewards (alpha 0.2) looks at them again under each threshold and each guard. A good
reward pays the expert most and the dither least, and bears few waypoints where one is
already (*false* births). Rewards are means per episode.
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
from torchrl.envs.transforms import Transform
from tqdm import tqdm, trange

from toponav.builders import Novelty, load_networks, make_explore_env
from toponav.builders.novelty import reward_threshold
from toponav.config import ExploreConfig, RewardConfig, register
from toponav.envs import load_maze
from toponav.evaluation import FrontierExpert, RandomPolicy, StickyPolicy
from toponav.keys import (
    BORN,
    COVERAGE,
    EMBEDDING,
    FALSE_BIRTH,
    HEADING,
    INTRINSIC_REWARD,
    POSITION,
)
from toponav.transforms import (
    CountReward,
    IntrinsicReward,
    TemporalDistanceReward,
    WaypointMemory,
    WaypointTruth,
)

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
    *("intrinsic_return", "births", "false_births", "return_of_experts"),
]


def make_settings(maze: str) -> ExploreConfig:
    """Settings of the laptop scale."""
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        settings = OmegaConf.to_object(compose("explore", overrides=[f"maze={maze}"]))
    assert isinstance(settings, ExploreConfig)
    return settings


def make_walks(maze: str, seed: int) -> dict[str, TensorDictModuleBase]:
    """The four walks, by name, the expert first."""
    return {
        "expert": FrontierExpert(torch.as_tensor(load_maze(maze).open_mask), seed=seed),
        "sticky": StickyPolicy(seed=seed),
        "random": RandomPolicy(seed=seed),
        "dither": StickyPolicy(0.0, weights=(0, 0, 1, 1, 0, 0), seed=seed),
    }


@torch.no_grad()
def record(
    settings: ExploreConfig,
    novelty: Novelty,
    walk: TensorDictModuleBase,
    *,
    episodes: int,
    seed: int,
) -> list[TensorDictBase]:
    """Embeddings, poses and coverage of a walk, ``[E]`` for each decision.

    The embeddings have the shape of views, ``[E, 1, 1, D]``, as the memory wants them.
    """
    keys = [EMBEDDING, POSITION, HEADING, COVERAGE]
    env = make_explore_env(settings, novelty, envs=episodes, seed=seed)
    try:
        data = env.reset()
        seen = [data.select(*keys).clone()]
        for _ in trange(settings.maze.episode_length - 1, desc="walk", leave=False):
            data = env.step_mdp(env.step(walk(data)))
            seen.append(data.select(*keys).clone())
    finally:
        env.close()
    return [data.set(VIEW, data.pop(EMBEDDING)[:, None, None]) for data in seen]


@torch.no_grad()
def reward(
    settings: ExploreConfig, novelty: Novelty, seen: list[TensorDictBase]
) -> TensorDict:
    """Means per episode of what a memory pays for a walk, and of its births."""
    paid, tc = settings.reward, novelty.tc
    memory = WaypointMemory(
        lambda views: views.flatten(1),
        tc.compare_prepared,
        prepare=tc.prepare_memory,
        threshold=float(novelty.threshold),
        persistence=paid.persistence,
        min_gap=paid.min_gap,
        count_on=paid.count_on,
        in_keys=[VIEW],
    )
    paying: list[Transform] = [
        CountReward(paid.alpha),
        TemporalDistanceReward(1 - paid.alpha, floor=paid.floor, clip=paid.clip),
        IntrinsicReward(),
    ]
    chain = [memory, *paying, WaypointTruth()]
    now = seen[0].clone()
    for transform in chain:
        now = transform._reset(TensorDict(batch_size=now.batch_size), now)
    total = torch.zeros(3, len(now))
    for data in seen[1:]:
        after = data.clone()
        for transform in chain:
            after = transform._step(now, after)
        counted = (INTRINSIC_REWARD, BORN, FALSE_BIRTH)
        total += torch.stack([after[key].float().squeeze(-1) for key in counted])
        now = after
    return total.mean(1)


def guarded(config: RewardConfig, changes: dict[str, object]) -> RewardConfig:
    """A memory with these guards and no others."""
    bare = {"persistence": 1, "min_gap": 1, "count_on": "every"}
    return replace(config, **{**bare, **changes})


def main() -> None:
    """Measure, print the table, keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--networks", required=True)
    parser.add_argument("--maze", default="maze3")
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    networks = load_networks(options.networks)
    settings = replace(make_settings(options.maze), model=networks.model)
    walks = {
        name: record(
            settings,
            Novelty(networks.tc),
            walk,
            episodes=options.episodes,
            seed=options.seed,
        )
        for name, walk in make_walks(options.maze, options.seed).items()
    }
    rows = []
    for threshold, guard in tqdm(list(product(("auto", "tc"), GUARDS)), desc="guard"):
        config = replace(settings.reward, threshold=threshold)
        level = reward_threshold(networks.thresholds, config)
        changed = replace(settings, reward=guarded(config, GUARDS[guard]))
        returns = {}
        for name, seen in walks.items():
            found = reward(changed, Novelty(networks.tc, level), seen).tolist()
            returns[name] = found[0]
            coverage = float(seen[-1][COVERAGE].mean())
            rows.append(
                [
                    *(options.maze, threshold, round(level, 3), guard, name),
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
