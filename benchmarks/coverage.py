"""Coverage of scripted policies: what a learner has to beat, and what is possible.

    python benchmarks/coverage.py --out results/coverage.csv
    python benchmarks/coverage.py --engine dmlab --mazes maze1 maze2 maze3 \
        --episodes 12 --expert-decisions 1800 --out results/dmlab/coverage.csv

Share of the maze's cells visited in 1800 decisions by a uniformly random walk and by
a sticky, forward-biased one, and the decisions that a frontier-following expert, who
knows the plan, takes to visit 90 % of the cells and every cell. Means over episodes
from random starts, with 95 % bootstrap intervals.
"""

import argparse
import csv
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


def main() -> None:
    """Measure, print the table, keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=128)
    parser.add_argument("--expert-decisions", type=int, default=600)
    parser.add_argument("--engine", choices=ENGINES, default=DEFAULT_ENGINE)
    parser.add_argument("--mazes", nargs="+", choices=MAZES, default=[*MAZES])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    world = load_engine(options.engine).world
    length = options.expert_decisions
    shared = {"engine": options.engine, "seed": options.seed}
    rows = []
    for maze in tqdm(options.mazes, desc="maze"):
        mask = torch.from_numpy(load_maze(maze).open_mask)
        walks = {
            "uniform random": RandomPolicy(world.num_actions, seed=options.seed),
            "sticky random": StickyPolicy(
                world.num_actions,
                weights=forward_weights(world),
                seed=options.seed,
            ),
        }
        for name, policy in walks.items():
            covered, _ = episodes(
                maze, policy, count=options.episodes, length=1800, **shared
            )
            rows.append([maze, name, "coverage after 1800 decisions, %", covered])
        covered, decisions = episodes(
            maze,
            FrontierExpert(mask, world=world, seed=options.seed),
            count=options.episodes // 2,
            length=length,
            **shared,
        )
        what = f"coverage after {length} decisions, %"
        rows.append([maze, "frontier expert", what, covered])
        for level, taken in zip(LEVELS, decisions.T, strict=True):
            what = f"decisions to {level:.0%}".replace("%", " %")
            rows.append([maze, "frontier expert", what, taken])
    table = []
    for maze, policy, what, values in rows:
        found = bootstrap(values)
        ends = [round(x, 1) for x in (found.value, found.low, found.high)]
        table.append([maze, policy, what, len(values), *ends])
    header = ["maze", "policy", "what", "episodes", "mean", "ci_low", "ci_high"]
    for row in [header, *table]:
        print("{:8} {:16} {:34} {:>8} {:>7} {:>7} {:>7}".format(*map(str, row)))
    if options.out:
        with options.out.open("w", newline="") as file:
            csv.writer(file).writerows([header, *table])


if __name__ == "__main__":
    main()
