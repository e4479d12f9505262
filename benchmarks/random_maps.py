"""How soon a map that random walks feed covers a maze, by the measure of explorers.

    python benchmarks/random_maps.py runs/explore/maze1-... \
        --out results/random_maps.csv

``decisions_to_cover`` of an exploration's ``map.csv`` counts its decisions until a
waypoint of the map lies in every cell. Here uniform random walks take the place of its
agents: its networks, thresholds and rules of a map, as many mazes that feed it, and
decisions counted of all its mazes. It is NaN if they did not cover the maze in as many
decisions as the exploration made. ``random_decisions_to_cover`` of
``benchmarks/main_rows.py`` counts for other walks until each cell was seen, which is
sooner.
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd
import torch
from pose_maps import read_settings
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Compose, InitTracker, TransformedEnv
from tqdm import tqdm

from toponav.builders import Networks, World, collect_rollout, load_networks
from toponav.config import ExploreConfig, maze_label
from toponav.keys import DONE, ENV_ID, IS_INIT, REWARD
from toponav.methods import make_world
from toponav.policies import RandomPolicy
from toponav.training import MapGrowth
from toponav.transforms import AreaDownsample, EmbedViews


@torch.no_grad()
def walks(
    settings: ExploreConfig,
    world: World,
    growth: MapGrowth,
    networks: Networks,
    seed: int,
) -> Iterator[TensorDictBase]:
    """Batches ``[E, T]`` of random walks, as a collector of explorers has them."""
    config, length = settings.collect, world.episode_length
    envs = settings.map.envs or config.envs
    base = world.make_env(batch_size=envs, seed=seed, privileged=True)
    small = AreaDownsample(factor=2 if settings.model.halve else 1)
    chain = Compose(small, EmbedViews(networks.tc.embed), InitTracker())
    env = TransformedEnv(base, chain)
    policy = RandomPolicy(world.spec.num_actions, seed=seed)
    keep = [key for key in growth.in_keys if key != IS_INIT and key[0] != "next"]
    number = torch.arange(envs).reshape(-1, 1, 1).expand(envs, length, 1)
    try:
        for _ in range(math.ceil(config.decisions / (config.envs * length))):
            frames = collect_rollout(env, policy, length, keep=keep).frames
            first = torch.zeros(envs, length, 1, dtype=torch.bool)
            last, reward = first.clone(), torch.zeros(envs, length, 1)
            first[:, 0], last[:, -1] = True, True
            frames = frames.clone(False).set(ENV_ID, number).set(IS_INIT, first)
            frames["next"] = TensorDict({DONE: last, REWARD: reward}, frames.shape)
            for piece in frames.split(settings.loss.rollout, 1):
                yield piece.contiguous()
    finally:
        env.close()


def decisions_to_cover(run: Path, seed: int) -> float:
    """Of all mazes of a run, until the map that random walks feed covers every cell."""
    networks = load_networks(run)
    settings = read_settings(run)
    world = make_world(settings)
    growth = MapGrowth(settings, world, networks)
    assert growth.truth is not None
    share = settings.collect.envs / (settings.map.envs or settings.collect.envs)
    for batch in tqdm(walks(settings, world, growth, networks, seed), desc=run.name):
        growth.extend(batch)
        if not math.isnan(found := growth.truth.decisions_to_cover):
            return found * share
    return math.nan


def read_run(run: Path, seeds: Sequence[int]) -> list[dict[str, object]]:
    """A row for each seed of the walks; beside it, what the exploration needed."""
    settings = read_settings(run)
    row = {"maze": maze_label(settings.maze.name, settings.maze.path)}
    explored = pd.read_csv(run / "map.csv").iloc[-1]["decisions_to_cover"]
    return [
        {
            **row,
            "networks": settings.seed,
            "explored_decisions_to_cover": explored,
            "walk_seed": seed,
            "random_decisions_to_cover": decisions_to_cover(run, seed),
        }
        for seed in seeds
    ]


def main() -> None:
    """Print the rows, and keep them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = pd.DataFrame(
        [row for run in options.runs for row in read_run(run, options.seeds)]
    )
    print(rows.to_string())
    if options.out:
        rows.to_csv(options.out, index=False, lineterminator="\n")


if __name__ == "__main__":
    main()
