"""How many updates does a loss need to learn what only a memory can do?

    PYTHONPATH=. python benchmarks/recall.py --out results/recall.csv

A corridor of 3 to so many decisions, whose first view tells the way out at its end:
1 for the right one, -1 for the other. Each learner is played every 25 updates; what is
written is the first of them that earns more than 0.8 in the mean of 500 episodes, or
nothing if none of the ``--updates`` did. An update is a batch of 32 envs.
"""

import argparse
import csv
from collections.abc import Callable
from itertools import product
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch.nn.utils import clip_grad_norm_
from torchrl.collectors import Collector

from tests.objectives.cue_corridor import make_env, make_network
from toponav.modules import ActorCritic
from toponav.objectives import (
    A3CLoss,
    RecurrentPPOLoss,
    SequenceMinibatches,
    SharedRMSProp,
)

NUM_ENVS, SLICE, EVERY = 32, 20, 25
Update = Callable[[TensorDictBase], None]


def descend(
    losses: TensorDictBase, optimizer: torch.optim.Optimizer, *, norm: float
) -> None:
    """One step of the optimiser."""
    total = sum(value for key, value in losses.items() if key.startswith("loss_"))
    optimizer.zero_grad()
    total.backward()
    clip_grad_norm_(optimizer.param_groups[0]["params"], norm)
    optimizer.step()


def a3c(network: ActorCritic, *, lr: float, eps: float) -> Update:
    """One step over each batch, with RMSProp as in ``conf/loss/a3c.yaml``."""
    loss = A3CLoss(network).make_value_estimator(gamma=0.99)
    optimizer = SharedRMSProp(network.parameters(), lr=lr, eps=eps)
    return lambda batch: descend(loss(batch), optimizer, norm=40.0)


def ppo(network: ActorCritic, *, lr: float) -> Update:
    """Two passes of two steps over each batch, with Adam."""
    loss = RecurrentPPOLoss(network).make_value_estimator(gamma=0.99, lmbda=0.95)
    optimizer = torch.optim.Adam(network.parameters(), lr=lr, eps=1e-5)
    minibatches = SequenceMinibatches(SLICE, num_minibatches=2, seed=0)

    def update(batch: TensorDictBase) -> None:
        batch = loss.estimate_advantage(batch)
        for _ in range(2):
            for part in minibatches(batch):
                descend(loss(part), optimizer, norm=0.5)

    return update


LEARNERS: dict[str, Callable[[ActorCritic], Update]] = {
    "ppo lr=3e-3": lambda network: ppo(network, lr=3e-3),
    "a3c lr=5e-3 eps=1e-3": lambda network: a3c(network, lr=5e-3, eps=1e-3),
    "a3c lr=7e-4 eps=1e-3": lambda network: a3c(network, lr=7e-4, eps=1e-3),
    "a3c lr=5e-3 eps=0.1": lambda network: a3c(network, lr=5e-3, eps=0.1),
    "ppo lr=4e-4": lambda network: ppo(network, lr=4e-4),
    "a3c lr=7e-4 eps=0.1": lambda network: a3c(network, lr=7e-4, eps=0.1),
}


def mean_return(network: ActorCritic, longest: int) -> float:
    """Mean return of about 500 episodes that the policy draws."""
    with torch.no_grad(), torch.random.fork_rng():
        torch.manual_seed(1)
        env = make_env(network, 64, seed=1, longest=longest)
        steps = 4 * (3 + longest)
        following = env.rollout(steps, network, break_when_any_done=False)["next"]
    return float(following["reward"].sum() / following["done"].sum())


def updates_to_learn(
    learner: str, *, longest: int, seed: int, most: int
) -> tuple[int | None, float]:
    """The first of the tried numbers of updates that are enough; the last return."""
    network = make_network(seed)
    update = LEARNERS[learner](network)
    collector = Collector(
        make_env(network, NUM_ENVS, seed=seed, longest=longest),
        network,
        frames_per_batch=NUM_ENVS * SLICE,
        total_frames=NUM_ENVS * SLICE * most,
        auto_register_policy_transforms=False,
    )
    found = 0.0
    for number, batch in enumerate(collector, start=1):
        update(batch)
        if number % EVERY == 0:
            found = mean_return(network, longest)
            if found > 0.8:
                collector.shutdown()
                return number, found
    return None, found


def main() -> None:
    """Train every learner in every corridor with every seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--longest", type=int, nargs="+", default=[4, 8])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--updates", type=int, default=1500)
    options = parser.parse_args()
    torch.set_num_threads(1)
    with options.out.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["learner", "longest", "seed", "updates", "mean_return"])
        for seed, longest, learner in product(options.seeds, options.longest, LEARNERS):
            updates, found = updates_to_learn(
                learner, longest=longest, seed=seed, most=options.updates
            )
            row = [learner, longest, seed, updates, f"{found:.3f}"]
            table.writerow(row)
            file.flush()
            print(*row, flush=True)


if __name__ == "__main__":
    main()
