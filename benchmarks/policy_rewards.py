"""What the novelty reward pays policies that cover more, and policies that cover less.

    python benchmarks/policy_rewards.py --networks runs/pretrain/random-... \
        --runs runs/explore/a runs/explore/b --out results/policy_rewards.csv \
        maze=random maze.rows=5 maze.cols=6 maze.seed=3

The best policies of some explorations play beside an expert and a sticky walk, and
their rewards are computed at several thresholds of the memory. Where a policy that
covers less is paid more, the reward is the limit, not the learner.
"""

import argparse
import csv
import sys
from dataclasses import replace
from pathlib import Path

import torch

from toponav.builders import load_networks
from toponav.keys import COVERAGE
from toponav.methods import LEARNERS, make_world

sys.path.append(str(Path(__file__).parent))
from reward_guards import compute_rewards, make_policies, make_settings, record

COLUMNS = ["policy", "coverage", "threshold", "return", "deviation", "new_waypoints"]


def main() -> None:
    """Play, compute the rewards, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("maze", nargs="+", help="settings of the maze")
    parser.add_argument("--networks", required=True)
    parser.add_argument("--runs", type=Path, nargs="*", default=[])
    parser.add_argument("--thresholds", type=float, nargs="+", default=[0.1, 0.35, 0.6])
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    networks = load_networks(options.networks)
    settings = make_settings(*options.maze, seed=options.seed).resolved(networks.model)
    world = make_world(settings)
    scripted = make_policies(world, options.seed)
    policies = {name: scripted[name] for name in ("expert", "sticky")}
    for run in options.runs:
        policy = LEARNERS[settings.loss.name].make_policy(settings, world)
        saved = torch.load(run / "policy.pt", weights_only=True)
        policy.load_state_dict(saved["weights"])
        policies[run.name] = policy
    rows = []
    for name, policy in policies.items():
        seen = record(settings, world, networks, policy, episodes=options.episodes)
        coverage = float(seen[-1][COVERAGE].mean())
        for threshold in options.thresholds:
            reward = replace(settings.reward, threshold=threshold)
            changed = replace(settings, reward=reward)
            _, sums = compute_rewards(changed, world, networks, seen)
            total, new = sums[0], sums[1]
            row = [name, coverage, threshold, total.mean(), total.std(), new.mean()]
            rows.append([name, *(round(float(value), 3) for value in row[1:])])
            print(*rows[-1], flush=True)
    if options.out:
        with options.out.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


if __name__ == "__main__":
    main()
