"""What does `ReturnScale` change of PPO, where returns are large?

    PYTHONPATH=. python benchmarks/ppo_cartpole.py --out results/ppo_cartpole.csv

CartPole pays 1 for each decision, up to 500 an episode. The package's policy is
trained with and without `ReturnScale`, by the functions of the test, and played after
some of the batches of 1,280 decisions; seconds are those of the training alone.
"""

import argparse
import csv
import time
from itertools import product
from pathlib import Path

import torch

from tests.objectives.test_ppo_on_cartpole import judge, make_policy, train


def main() -> None:
    """Train with every seed, with and without; a line a score."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--batches", type=int, nargs="+", default=[5, 10, 15, 20, 30])
    options = parser.parse_args()
    torch.set_num_threads(1)
    with options.out.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["return_scale", "seed", "batches", "mean_return", "seconds"])
        for seed, is_scaled in product(options.seeds, (True, False)):
            policy = make_policy(seed)
            most, seconds, start = max(options.batches), 0.0, time.perf_counter()
            for batch in train(policy, batches=most, seed=seed, is_scaled=is_scaled):
                seconds += time.perf_counter() - start
                if batch in options.batches:
                    score = f"{judge(policy, seed):.1f}"
                    row = [is_scaled, seed, batch, score, f"{seconds:.0f}"]
                    table.writerow(row)
                    file.flush()
                    print(*row, flush=True)
                start = time.perf_counter()


if __name__ == "__main__":
    main()
