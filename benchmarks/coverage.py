"""Coverage of scripted policies: what a learner has to beat, and what is possible.

    python benchmarks/coverage.py --episodes 64 --seeds 0 1 2 --out results/coverage.csv
    python benchmarks/coverage.py --engine dmlab --mazes maze1 maze2 maze3 \
        --episodes 12 --expert-decisions 1800 --out results/dmlab/coverage.csv

Share of the maze's cells visited in 1800 decisions by a uniformly random walk and by
a sticky, forward-biased one, and the decisions that a frontier-following expert, who
knows the plan, takes to visit 90 % of the cells and every cell. Means over episodes
from random starts, as many with each seed, with 95 % bootstrap intervals.
"""

import argparse
import csv
from functools import partial
from pathlib import Path

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import InitTracker, TransformedEnv
from tqdm import tqdm

from toponav.builders import collect_rollout
from toponav.envs import (
    DEFAULT_ENGINE,
    ENGINES,
    MAZES,
    MazeEnv,
    load_engine,
    load_maze,
)
from toponav.keys import COVERAGE, DECISIONS_TO_COVERAGE
from toponav.metrics import bootstrap
from toponav.policies import (
    FrontierExpert,
    RandomPolicy,
    StickyPolicy,
    forward_weights,
)
from toponav.transforms import Coverage

BATCH = 16
LEVELS = (0.9, 1.0)
MEASURED = (COVERAGE, DECISIONS_TO_COVERAGE)


def episodes(
    maze: str,
    policy: TensorDictModuleBase,
    *,
    engine: str,
    count: int,
    length: int,
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Final coverage in percent, and decisions to 90 and 100 %, of each episode."""
    layout, batch = load_maze(maze), min(BATCH, count)
    base = MazeEnv(
        layout,
        engine=engine,
        batch_size=batch,
        privileged=True,
        seed=seed,
        episode_length=length + 1,
    )
    meter = Coverage(torch.from_numpy(layout.open_mask), levels=LEVELS)
    env = TransformedEnv(base, meter).append_transform(InitTracker())
    covered, decisions = [], []
    try:
        for _ in range(-(-count // batch)):
            played = collect_rollout(env, policy, length, keep=(), keep_next=MEASURED)
            last = played.frames["next"][:, -1]
            covered.append(100 * last[COVERAGE][:, 0].numpy())
            decisions.append(last[DECISIONS_TO_COVERAGE].numpy())
    finally:
        env.close()
    return np.concatenate(covered)[:count], np.concatenate(decisions)[:count]


def play(
    maze: str, *, engine: str, seed: int, walks: int, length: int
) -> dict[tuple[str, str], np.ndarray]:
    """Policies and what is measured of them to a value of each episode of a seed."""
    world, measure = load_engine(engine).world, partial(episodes, maze, engine=engine)
    mask = torch.from_numpy(load_maze(maze).open_mask)
    weights = forward_weights(world)
    policies = {
        "uniform random": RandomPolicy(world.num_actions, seed=seed),
        "sticky random": StickyPolicy(world.num_actions, weights=weights, seed=seed),
    }
    found = {}
    for name, policy in policies.items():
        covered, _ = measure(policy, count=walks, length=1800, seed=seed)
        found[name, "coverage after 1800 decisions, %"] = covered
    name, policy = "frontier expert", FrontierExpert(mask, world=world, seed=seed)
    covered, taken = measure(policy, count=walks // 2, length=length, seed=seed)
    found[name, f"coverage after {length} decisions, %"] = covered
    for level, decisions in zip(LEVELS, taken.T, strict=True):
        found[name, f"decisions to {100 * level:.0f} %"] = decisions
    return found


def main() -> None:
    """Measure, print the table, keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=128)
    parser.add_argument("--expert-decisions", type=int, default=600)
    parser.add_argument("--engine", choices=ENGINES, default=DEFAULT_ENGINE)
    parser.add_argument("--mazes", nargs="+", choices=MAZES, default=[*MAZES])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    played = partial(
        play,
        engine=options.engine,
        walks=options.episodes,
        length=options.expert_decisions,
    )
    table = []
    for maze in tqdm(options.mazes, desc="maze"):
        seeds = [played(maze, seed=seed) for seed in tqdm(options.seeds, desc="seed")]
        for policy, what in seeds[0]:
            values = np.concatenate([one[policy, what] for one in seeds])
            found = bootstrap(values)
            ends = [round(x, 1) for x in (found.value, found.low, found.high)]
            table.append([maze, policy, what, len(seeds), len(values), *ends])
    header = ["maze", "policy", "what", "seeds", "episodes"]
    header += ["mean", "ci_low", "ci_high"]
    for row in [header, *table]:
        print("{:8} {:16} {:34} {:>5} {:>8} {:>7} {:>7} {:>7}".format(*map(str, row)))
    if options.out:
        with options.out.open("w", newline="") as file:
            csv.writer(file).writerows([header, *table])


if __name__ == "__main__":
    main()
