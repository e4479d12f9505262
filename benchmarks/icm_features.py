"""Does ICM learn features in a maze, and from how many decisions on?

    python benchmarks/icm_features.py --out results/icm_features.csv

Both models learn from the same uniformly random walks in a maze, pass after pass,
with and without the forward model's error training the features. A line a pass says
how well the inverse model names actions of a part of the walks that it never saw (one
in six by chance), and how large the forward model's error, the reward, is there.
"""

import argparse
import csv
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torch.nn.utils import clip_grad_norm_
from torchrl.envs import TransformedEnv
from tqdm import tqdm

from toponav.envs import MazeEnv, load_maze
from toponav.keys import FRAME_STACK
from toponav.methods.rewards import GreyStack, IntrinsicCuriosity

SIZE, FRAMES, ENVS = (42, 42), 4, 16
#: Weight of the forward model's loss, largest norm of a gradient: those of conf/reward.
BETA, MAX_GRAD_NORM = 0.2, 0.2
COLUMNS = (
    *("forward_trains_features", "lr", "passes", "updates", "loss_inverse"),
    *("inverse_accuracy", "error"),
)
Steps = tuple[Tensor, Tensor, Tensor]


def record(maze: str, decisions: int, seed: int) -> tuple[Steps, Steps]:
    """Stacks before, actions and stacks after of walks; the last fifth apart."""
    env = MazeEnv(load_maze(maze), batch_size=ENVS)
    env = TransformedEnv(env, GreyStack(SIZE, FRAMES))
    env.set_seed(seed)
    torch.manual_seed(seed)
    walk = env.rollout(decisions // ENVS, break_when_any_done=False)
    env.close()
    steps = walk[FRAME_STACK], walk["action"], walk["next", FRAME_STACK]
    known = walk.shape[1] * 4 // 5
    learned = tuple(one[:, :known].flatten(0, 1) for one in steps)
    unseen = tuple(one[:, known:].flatten(0, 1) for one in steps)
    return learned, unseen


def learn(
    icm: IntrinsicCuriosity, steps: Steps, lr: float, minibatch: int, passes: int
) -> Iterator[tuple[float, int]]:
    """Train both models; gives the inverse loss and the updates after each pass."""
    optimizer = torch.optim.Adam(icm.parameters(), lr=lr)
    updates = 0
    for _ in range(passes):
        losses = []
        for rows in torch.randperm(len(steps[1])).split(minibatch):
            before, action, after = (one[rows] for one in steps)
            logits, error = icm(before, action, after)
            inverse = F.cross_entropy(logits, action)
            optimizer.zero_grad()
            ((1 - BETA) * inverse + BETA * error.mean()).backward()
            clip_grad_norm_(icm.parameters(), MAX_GRAD_NORM)
            optimizer.step()
            losses.append(float(inverse.detach()))
            updates += 1
        yield sum(losses) / len(losses), updates


@torch.no_grad()
def judge(icm: IntrinsicCuriosity, steps: Steps) -> tuple[float, float]:
    """Share of actions that the inverse model names, and the forward model's error."""
    logits, error = icm(*steps)
    return float((logits.argmax(-1) == steps[1]).float().mean()), float(error.mean())


def main() -> None:
    """Train each form; a line a pass."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--maze", default="select")
    parser.add_argument("--decisions", type=int, default=25_600)
    parser.add_argument("--passes", type=int, default=5)
    parser.add_argument("--minibatch", type=int, default=40)
    parser.add_argument("--rates", type=float, nargs="+", default=[1e-4, 1e-3])
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    learned, unseen = record(options.maze, options.decisions, options.seed)
    with options.out.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        forms = [*product((True, False), options.rates)]
        with tqdm(total=len(forms) * options.passes, unit="pass") as progress:
            for is_trained, lr in forms:
                torch.manual_seed(options.seed)
                icm = IntrinsicCuriosity(6, forward_trains_features=is_trained)
                made = learn(icm, learned, lr, options.minibatch, options.passes)
                for number, (loss, updates) in enumerate(made, 1):
                    accuracy, error = judge(icm, unseen)
                    row = [is_trained, lr, number, updates, f"{loss:.3f}"]
                    table.writerow([*row, f"{accuracy:.3f}", f"{error:.4g}"])
                    file.flush()
                    progress.update()


if __name__ == "__main__":
    main()
