"""Does the error of RND tell places that its predictor has seen from those it has not?

    python benchmarks/rnd_novelty.py --out results/rnd_novelty.json

Views of sticky random walks in the development maze; half of its cells, drawn at
random, count as seen. A predictor learns from views of seen cells, and then its errors
on other views of seen cells are compared with those on unseen cells. The AUC is the
probability that an unseen cell's view has the larger error: 0.5 is a coin, 1 would pay
for new places alone. Beside it stands the share of the target's variance that is not
predicted, for views and training of several sizes.
"""

import argparse
import json
import time
from pathlib import Path

import torch
from sklearn.metrics import roc_auc_score
from torch import Tensor
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import ExcludeTransform
from tqdm import tqdm

from toponav.envs import MazeEnv, load_maze
from toponav.keys import CELL, PIXELS, POLICY_PIXELS
from toponav.methods.rewards import RandomNetworkDistillation
from toponav.policies import StickyPolicy, forward_weights
from toponav.transforms import PolicyPixels

#: Height and width of the views, learning rate of the predictor. 84 pixels and 1e-4 are
#: Burda et al.'s and the defaults of ``reward=rnd``.
TRIALS = ((84, 1e-4), (84, 1e-3), (42, 1e-4), (42, 1e-3))
EPOCHS = (1, 3, 10)
ENVS, BATCH, HELD_OUT = 32, 80, 1000


def collect_views(side: int, *, decisions: int, seed: int) -> tuple[Tensor, Tensor]:
    """Views ``[N, side, side, 3]`` of walks, and the cell of each, ``[N, 2]``."""
    maze = MazeEnv(
        load_maze("select"),
        batch_size=ENVS,
        episode_length=100,
        privileged=True,
        paintings=0.5,
        marks=1.0,
        seed=seed,
    )
    env = TransformedEnv(maze, PolicyPixels(size=(side, side)))
    env.append_transform(ExcludeTransform(PIXELS))
    weights = forward_weights(maze.world)
    policy = StickyPolicy(maze.world.num_actions, weights=weights, seed=seed)
    try:
        frames = env.rollout(decisions, policy, break_when_any_done=False)["next"]
    finally:
        env.close()
    return frames[POLICY_PIXELS].flatten(0, 1), frames[CELL].flatten(0, 1)


def errors_of(rnd: RandomNetworkDistillation, views: Tensor) -> Tensor:
    """Mean squared error of each view, ``[N]``."""
    with torch.no_grad():
        return torch.cat(
            [
                (rnd.predictor(piece) - rnd.target(piece)).square().mean(-1)
                for piece in views.split(250)
            ]
        )


def measure(
    views: Tensor, seen: Tensor, lr: float, seed: int
) -> list[dict[str, float]]:
    """Train on views of seen cells; a row after each of `EPOCHS`."""
    torch.manual_seed(seed)
    order = torch.randperm(len(views))
    known, unseen = order[seen[order]], views[order[~seen[order]][:HELD_OUT]]
    held_out, train = views[known[:HELD_OUT]], views[known[HELD_OUT:]]
    rnd = RandomNetworkDistillation(tuple(views.shape[1:3]), width=16, feature_dim=256)
    rnd.update(train)
    optimizer = torch.optim.Adam(rnd.predictor.parameters(), lr=lr)
    with torch.no_grad():
        variance = float(rnd.target(held_out).var(0).mean())
    rows = []
    for epoch in tqdm(range(1, max(EPOCHS) + 1), desc=f"{views.shape[1]} px, {lr:g}"):
        for rows_of_batch in torch.randperm(len(train)).split(BATCH):
            batch = train[rows_of_batch]
            loss = (rnd.predictor(batch) - rnd.target(batch)).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        if epoch in EPOCHS:
            of_seen, of_unseen = errors_of(rnd, held_out), errors_of(rnd, unseen)
            labels = [0] * len(of_seen) + [1] * len(of_unseen)
            rows.append(
                {
                    "view_size": views.shape[1],
                    "lr": lr,
                    "epochs": epoch,
                    "training_views": len(train),
                    "seen_unexplained": round(float(of_seen.mean()) / variance, 3),
                    "unseen_unexplained": round(float(of_unseen.mean()) / variance, 3),
                    "auc": round(
                        roc_auc_score(labels, torch.cat([of_seen, of_unseen])), 3
                    ),
                }
            )
    return rows


def main() -> None:
    """Measure each trial, print and keep the rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--decisions", type=int, default=800, help="of each env")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    begin, rows = time.monotonic(), []
    for side, lr in TRIALS:
        views, cells = collect_views(
            side, decisions=options.decisions, seed=options.seed
        )
        places, place = cells.unique(dim=0, return_inverse=True)
        draw = torch.Generator().manual_seed(options.seed)
        is_seen = torch.randperm(len(places), generator=draw) < len(places) // 2
        rows += measure(views, is_seen[place], lr, options.seed)
    found = {"seconds": round(time.monotonic() - begin), "rows": rows}
    text = json.dumps(found, indent=1)
    print(text)
    if options.out:
        options.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
