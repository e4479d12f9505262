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
import csv
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import torch
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

#: Rows of the maze of points; the way from the first cell to the last one is a snake.
PLAN = (".........", "########.", ".........", ".########", ".........")
PLAN += ("########.", ".........")


class PointTask(EnvBase):
    """A batch of points that move by numbered actions; 1 at the goal, which is the end.

    What is observed is the state within `low` and `high`, from -1 to 1.

    Args:
        num_envs: number E of them.
        num_actions: number of actions.
        longest: decisions after which an episode is truncated.
        seed: of the starts.
    """

    num_places: int
    low: tuple[float, float]
    high: tuple[float, float]

    def __init__(self, num_envs: int, num_actions: int, longest: int, seed: int):
        super().__init__(batch_size=[num_envs])
        self.longest = longest
        self.generator = torch.Generator().manual_seed(seed)
        shape = (num_envs, 1)
        self.observation_spec = Composite(
            observation=Unbounded((num_envs, 2)),
            state=Unbounded((num_envs, 2)),
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
        """States at an episode's start, ``[N, 2]``."""
        raise NotImplementedError

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """States after a decision, and whether they are at the goal, ``[E]``."""
        raise NotImplementedError

    def place(self, state: Tensor) -> Tensor:
        """The number of each state's place, ``[E]``."""
        raise NotImplementedError

    def _entries(self, state: Tensor, age: Tensor) -> dict[str, Tensor]:
        low, high = torch.tensor(self.low), torch.tensor(self.high)
        seen = 2 * (state - low) / (high - low) - 1
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
    """A snake of cells; a decision moves by half a cell, unless a wall is there."""

    num_places = sum(line.count(".") for line in PLAN)
    low, high = (0.0, 0.0), (float(len(PLAN)), float(len(PLAN[0])))

    def __init__(self, num_envs: int, seed: int) -> None:
        self.is_open = torch.tensor([[sign == "." for sign in line] for line in PLAN])
        # Open cells are numbered in reading order.
        self.numbers = self.is_open.flatten().cumsum(0).reshape(self.is_open.shape) - 1
        super().__init__(num_envs, 4, 200, seed)

    def start(self, num: int) -> Tensor:
        return 0.25 + 0.5 * torch.rand(num, 2, generator=self.generator)

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        step = 0.5 * torch.tensor([[1.0, 0], [-1, 0], [0, 1], [0, -1]])[action]
        size = torch.tensor(self.is_open.shape)
        moved = state + step
        row, column = self._cells(moved)
        inside = ((moved >= 0) & (moved < size)).all(-1)
        free = inside & self.is_open[row, column]
        state = torch.where(free.unsqueeze(-1), moved, state)
        return state, self.place(state) == self.num_places - 1

    def place(self, state: Tensor) -> Tensor:
        row, column = self._cells(state)
        return self.numbers[row, column]

    def _cells(self, state: Tensor) -> tuple[Tensor, Tensor]:
        last = torch.tensor(self.is_open.shape) - 1
        row, column = torch.minimum(state.long().clamp_min(0), last).unbind(-1)
        return row, column


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
    """With smaller networks and other rates than those of ``conf/reward/ex2.yaml``."""
    exemplars = AmortisedExemplars((2,), code_dim=8, hidden=16)
    trainer = ExemplarTrainer(exemplars, lr=3e-3, update_rate=0.02, kl_weight=0.01)

    def learn(batch: TensorDictBase) -> dict[str, float]:
        return trainer.extend(batch["next", "observation"].reshape(-1, 2))

    return Bonus(ExemplarReward(exemplars, 1e-2, key="observation"), learn)


#: Of each task: what makes it, environments, decisions, and the methods to compare.
TASKS = {
    "mountain_car": (MountainCar, 50, 125_000, ("trpo", "vime")),
    "point_maze": (PointMaze, 100, 100_000, ("trpo", "ex2")),
}
#: Batches of a row.
ROW = 5
METHODS = {"vime": make_vime, "ex2": make_ex2}


def explore(task: str, method: str, seed: int, write: Callable[..., None]) -> None:
    """Learn a task with one method; ``write`` gets the columns of each batch."""
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
            shares = (len(places) / plain.num_places, len(so_far) / plain.num_places)
            write(number * size, float(torch.cat(ended).mean()), *shares)
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
    with options.out.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        head = ["task", "seed", "method", "decisions", "goal_share", "places"]
        table.writerow([*head, "places_so_far", "wall_s", "cpu_s"])
        for seed, task in product(options.seeds, options.tasks):
            for method in TASKS[task][-1]:
                wall, cpu = time.perf_counter(), time.process_time()

                def write(decisions: int, *shares: float) -> None:
                    spent = time.perf_counter() - wall, time.process_time() - cpu  # noqa: B023
                    numbers = [f"{share:.3f}" for share in shares]
                    row = [task, seed, method, decisions, *numbers]  # noqa: B023
                    table.writerow([*row, *(f"{one:.1f}" for one in spent)])
                    file.flush()

                explore(task, method, seed, write)
                print(task, seed, method, time.process_time() - cpu, flush=True)


if __name__ == "__main__":
    main()
