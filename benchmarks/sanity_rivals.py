"""VIME on a MountainCar that is rewarded at its goal alone, EX2 in a maze of points.

    PYTHONPATH=. python benchmarks/sanity_rivals.py --out results/sanity_rivals.csv

The transforms and models are those of ``reward=vime`` and ``reward=ex2``, here over
vectors; the learner is TRPO as in `sanity_trpo`, once with the reward and once without.
The rewards of the task (1 at the goal) and of the method are added. A row is as many
decisions as a full episode of every environment, five batches: the share of episodes
that ended in it at the goal, and the share of the places (12 x 12 of position and
speed, or cells of the maze) that were visited in it, and so far.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import torch
from sanity_curves import CurveTable
from sanity_trpo import Agent
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.transforms import Transform

from toponav.methods.rewards import (
    AmortisedExemplars,
    BayesianDynamics,
    DynamicsTrainer,
    ExemplarReward,
    ExemplarTrainer,
    InformationGainReward,
)


class PointTask(EnvBase):
    """A batch of points that move by numbered actions; 1 at the goal, which is the end.

    What is observed is a state within `low` and `high`, from -1 to 1.

    Args:
        num_envs: number E of them.
        num_actions: number of actions.
        longest: decisions after which an episode is truncated.
        seed: of the starts.
        numbers: that a state consists of; the first two are observed.
    """

    num_places: int
    low: tuple[float, float]
    high: tuple[float, float]

    def __init__(
        self, num_envs: int, num_actions: int, longest: int, seed: int, numbers: int = 2
    ) -> None:
        super().__init__(batch_size=[num_envs])
        self.longest = longest
        self.generator = torch.Generator().manual_seed(seed)
        shape = (num_envs, 1)
        self.observation_spec = Composite(
            observation=Unbounded((num_envs, 2)),
            state=Unbounded((num_envs, numbers)),
            place=Unbounded(shape, dtype=torch.int64),
            age=Unbounded(shape, dtype=torch.int64),
            shape=[num_envs],
        )
        self.action_spec = Categorical(num_actions, shape=(num_envs,))
        self.reward_spec = Unbounded(shape)
        flag = Categorical(2, shape=shape, dtype=torch.bool)
        names = ("done", "terminated", "truncated")
        self.done_spec = Composite({name: flag for name in names}, shape=[num_envs])

    def start(self, num: int) -> Tensor:
        """States at an episode's start, ``[N, K]``."""
        raise NotImplementedError

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """States after a decision, and whether they are at the goal, ``[E]``."""
        raise NotImplementedError

    def place(self, state: Tensor) -> Tensor:
        """The number of each state's place, ``[E]``."""
        raise NotImplementedError

    def _entries(self, state: Tensor, age: Tensor) -> dict[str, Tensor]:
        low, high = torch.tensor(self.low), torch.tensor(self.high)
        seen = 2 * (state[..., :2] - low) / (high - low) - 1
        place = self.place(state).unsqueeze(-1)
        return {"observation": seen, "state": state, "place": place, "age": age}

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object):
        # TorchRL keeps what goes on.
        age = torch.zeros(*self.batch_size, 1, dtype=torch.int64)
        entries = self._entries(self.start(len(age)), age)
        flags = dict.fromkeys(("done", "terminated", "truncated"), age.bool())
        return TensorDict({**entries, **flags}, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        state, there = self.move(tensordict["state"], tensordict["action"])
        age, there = tensordict["age"] + 1, there.unsqueeze(-1)
        late = age >= self.longest
        flags = {"done": there | late, "terminated": there, "truncated": late & ~there}
        entries = {**self._entries(state, age), **flags, "reward": there.float()}
        return TensorDict(entries, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(seed or 0)


class MountainCar(PointTask):
    """Gymnasium's car in a valley, by its equations: position and speed."""

    num_places = 144
    low, high = (-1.2, -0.07), (0.6, 0.07)

    def __init__(self, num_envs: int, seed: int) -> None:
        super().__init__(num_envs, 3, 500, seed)

    def start(self, num: int) -> Tensor:
        position = -0.6 + 0.2 * torch.rand(num, generator=self.generator)
        return torch.stack([position, torch.zeros(num)], -1)

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        position, speed = state.unbind(-1)
        speed = speed + 0.001 * (action - 1) - 0.0025 * (3 * position).cos()
        speed = speed.clamp(-0.07, 0.07)
        position = (position + speed).clamp(-1.2, 0.6)
        # The wall on the left stops it.
        speed = torch.where((position <= -1.2) & (speed < 0), 0.0, speed)
        return torch.stack([position, speed], -1), position >= 0.5

    def place(self, state: Tensor) -> Tensor:
        low, high = torch.tensor(self.low), torch.tensor(self.high)
        part = (state - low) / (high - low)
        row, column = (12 * part).long().clamp(0, 11).unbind(-1)
        return 12 * row + column


class PointMaze(PointTask):
    """The maze of EX2's authors: a ball of 0.1 kg in a square that a wall divides.

    The wall leaves a gap at one end, and start and goal are at the other end, on either
    side. A decision pushes the ball with 0.5 N for 0.02 s; what is observed is where it
    is, not how fast. Lengths are in metres, and bounds are those of its centre.
    """

    num_places = 86  # of 0.05 m, ten by ten without those of the wall
    low, high = (-0.25, -0.25), (0.25, 0.25)
    wall = (0.05, 0.1)  # half its width, and where the gap begins
    inertia, damping, substep = 0.113, 1.0, 0.01

    def __init__(self, num_envs: int, seed: int) -> None:
        super().__init__(num_envs, 4, 200, seed, numbers=4)

    def start(self, num: int) -> Tensor:
        near = 0.02 * torch.rand(num, 4, generator=self.generator) - 0.01
        return near + torch.tensor([-0.15, -0.15, 0, 0])

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        force = 0.5 * torch.tensor([[1.0, 0], [-1, 0], [0, 1], [0, -1]])[action]
        position, speed = state.clone().split(2, -1)
        rate = self.substep / self.inertia
        for _ in range(2):
            speed = (speed + rate * force) / (1 + rate * self.damping)
            for axis in range(2):
                moved = position.clone()
                moved[:, axis] += self.substep * speed[:, axis]
                free = self.is_free(moved)
                position = torch.where(free.unsqueeze(-1), moved, position)
                speed[:, axis] *= free
        goal = torch.tensor([0.15, -0.15])
        near = (position - goal).abs().sum(-1) < 0.12
        return torch.cat([position, speed], -1), near

    def is_free(self, position: Tensor) -> Tensor:
        """Whether the ball may be there, ``[E, 2]`` to ``[E]``."""
        inside = (position.abs() <= self.high[0]).all(-1)
        half, gap = self.wall
        return inside & ~((position[:, 0].abs() < half) & (position[:, 1] < gap))

    def place(self, state: Tensor) -> Tensor:
        part = (state[:, :2] - self.low[0]) / (self.high[0] - self.low[0])
        column, row = (10 * part).long().clamp(0, 9).unbind(-1)
        return 10 * row + column


@dataclass
class Bonus:
    """What a method adds to a task: a transform, and what learns from a batch."""

    transform: Transform
    learn: Callable[[TensorDictBase], dict[str, float]]


def make_vime(env: PointTask) -> Bonus:
    """With the settings of ``conf/reward/vime.yaml``."""
    dynamics = BayesianDynamics((2,), env.action_spec.n)
    trainer = DynamicsTrainer(dynamics, update_rate=0.02, minibatch=50)

    def learn(batch: TensorDictBase) -> dict[str, float]:
        flat = batch.reshape(-1)
        later = flat["next", "observation"]
        return trainer.extend(flat["observation"], flat["action"], later)

    return Bonus(InformationGainReward(dynamics, 1e-4, key="observation"), learn)


def make_ex2(env: PointTask) -> Bonus:
    """With the numbers of the authors' script for their maze of points."""
    exemplars = AmortisedExemplars((2,), code_dim=8, hidden=16)
    trainer = ExemplarTrainer(exemplars, kl_weight=0.01, capacity=200_000)

    def learn(batch: TensorDictBase) -> dict[str, float]:
        return trainer.extend(batch["next", "observation"].reshape(-1, 2))

    return Bonus(ExemplarReward(exemplars, 1e-2, key="observation"), learn)


#: Of each task: what makes it, environments, decisions, and the methods to compare.
TASKS = {
    "mountain_car": (MountainCar, 50, 125_000, ("trpo", "vime")),
    "point_maze": (PointMaze, 100, 200_000, ("trpo", "ex2")),
}
#: Batches of a row.
ROW = 5
METHODS = {"vime": make_vime, "ex2": make_ex2}


def explore(task: str, method: str, seed: int) -> Iterator[tuple[object, ...]]:
    """Learn a task with one method; rows of decisions and measures."""
    make, num_envs, decisions, _ = TASKS[task]
    torch.manual_seed(seed)
    plain = make(num_envs, seed)
    bonus = METHODS[method](plain) if method in METHODS else None
    env = TransformedEnv(plain, bonus.transform) if bonus else plain
    agent = Agent(env, gamma=0.99, reward="total", minibatch=500)
    size = num_envs * plain.longest // ROW
    collector = Collector(env, agent.policy, frames_per_batch=size, total_frames=-1)
    places: set[int] = set()
    so_far: set[int] = set()
    ended: list[Tensor] = []
    for number, batch in enumerate(collector, start=1):
        following = batch["next"]
        intrinsic = following.get("intrinsic_reward", torch.zeros(()))
        batch.set(("next", "total"), following["reward"] + intrinsic)
        agent.update(batch)
        if bonus:
            bonus.learn(batch)
        places |= set(following["place"].flatten().tolist())
        ended.append(following["terminated"][following["done"]].float())
        if number % ROW == 0:
            so_far |= places
            share = float(torch.cat(ended).mean())
            parts = (len(seen) / plain.num_places for seen in (places, so_far))
            yield (number * size, *(f"{one:.3f}" for one in (share, *parts)))
            places, ended = set(), []
        if number * size >= decisions:
            break
    collector.shutdown()


def main() -> None:
    """Explore every task with its methods and every seed, and write the curves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), choices=TASKS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    options = parser.parse_args()
    torch.set_num_threads(1)
    table = CurveTable(options.out, ("goal_share", "places", "places_so_far"))
    for task, seed in product(options.tasks, options.seeds):
        for method in TASKS[task][-1]:
            if not table.has(task, seed, method):
                table.add((task, seed, method), explore(task, method, seed))


if __name__ == "__main__":
    main()
