r"""DQN and DRQN in two games and two rooms, Nav A3C and D2L in a maze.

    PYTHONPATH=. python benchmarks/sanity_navigation.py \
        --out results/sanity_navigation.csv

The tasks are those of `sanity_tasks`, the learners those of ``recipes/explore.py``, in
one process. A row has the mean reward of an episode (games: 64 without random actions,
1 is the best, -1 the worst; rooms: 64 with 5 % of them, and the share that was paid) or
of 100 decisions (maze: those since the last row, 10 for the goal), and what D2L's heads
say of decisions that nothing was learned from yet. A figure is beside the table;
``--tasks`` without a name draws it alone.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from matplotlib.figure import Figure
from sanity_games import GameWorld
from sanity_tasks import GAMES, TASKS, FixedGoal, settings_of, world_of
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from toponav.builders import Learner
from toponav.config import ExploreConfig, TrainingError
from toponav.methods import LEARNERS, make_reward
from toponav.plotting import save_figure
from toponav.policies import RandomPolicy
from toponav.training import Explorer, make_explore_env

HEADS = ("depth_accuracy", "depth_chance", "loop_found", "loop_false")
COLUMNS = ["task", "learner", "seed", "decisions", "reward", "success"]
COLUMNS += [*HEADS, "cpu_s"]
LEARN = ("random", "dqn", "drqn", "nav_a3c", "nav_a3c_d2l")
Row = dict[str, Any]


def check(figures: Mapping[str, float], update: int) -> None:
    """Stop at a number that is none."""
    if bad := [name for name, value in figures.items() if not math.isfinite(value)]:
        raise TrainingError(f"{bad[0]} must be finite, got another in update {update}")


def make_learner(settings: ExploreConfig, world: Any, share: list[float]) -> Learner:
    """The learner of one run; ``share`` holds how much of it is over."""
    return LEARNERS[settings.loss.name](
        settings, world, reward="reward", check=check, progress=lambda: share[0]
    )


def make_learning_env(
    settings: ExploreConfig, world: Any, learner: Learner, *, envs: int, seed: int
) -> EnvBase:
    """A batch of environments with all that the learner and its policy read."""
    if isinstance(world, GameWorld):
        # Its views are the policy's at once.
        primer = learner.policy.make_tensordict_primer()
        game = world.make_env(batch_size=envs, seed=seed)
        return TransformedEnv(game, Compose(InitTracker(), primer))
    explorer = Explorer(learner.policy, make_reward(settings, world, None), None)
    # Episodes of a maze all end by the clock.
    arguments = {"stagger": isinstance(world, FixedGoal), "teach": True}
    return make_explore_env(
        settings, world, explorer, envs=envs, seed=seed, **arguments
    )


def last_rewards(steps: TensorDictBase) -> Tensor:
    """Rewards ``[E]`` at the end of the first episode of each row of ``[E, T]``."""
    over = steps["next", "done"].cumsum(1)
    first = (over == 1) & steps["next", "done"]
    return steps["next", "reward"][first]


def play(task: str, learner: Learner, judge: EnvBase) -> dict[str, float]:
    """What is measured of the policy as it is now."""
    length, policy = TASKS[task].length, learner.policy
    if task in GAMES:
        with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
            steps = judge.rollout(length, policy, break_when_any_done=False)
        return {"reward": float(last_rewards(steps).mean())}
    # A few random actions, as the learners play once they are trained.
    epsilon = policy.epsilon.clone()
    learner.settle(policy)
    arguments = {"break_when_any_done": False, "break_when_all_done": True}
    with set_exploration_type(ExplorationType.RANDOM), torch.no_grad():
        steps = judge.rollout(length, policy, **arguments)
    policy.epsilon.copy_(epsilon)
    return measure_rooms(steps)


def measure_rooms(steps: TensorDictBase) -> dict[str, float]:
    """Mean reward, which falls with the decisions, and the share that got any."""
    rewards = last_rewards(steps)
    share = float((rewards > 0).float().mean())
    return {"reward": float(rewards.mean()), "success": share}


def learn(
    task: str, loss: str, seed: int
) -> Iterator[
    tuple[int, TensorDictBase, Mapping[str, float], Callable[[], dict[str, float]]]
]:
    """Batches of one run: decisions so far, the batch, what was measured, a test."""
    torch.manual_seed(seed)
    settings, share = settings_of(task, loss, seed), [0.0]
    decisions, envs = TASKS[task].decisions, settings.collect.envs
    world = world_of(task, settings)
    learner = make_learner(settings, world, share)
    env = make_learning_env(settings, world, learner, envs=envs, seed=seed)
    judge = None
    if task != "maze":
        arguments = {"envs": 64, "seed": 1000 + seed}
        judge = make_learning_env(settings, world, learner, **arguments)

    def test() -> dict[str, float]:
        return {} if judge is None else play(task, learner, judge)

    size = envs * settings.loss.rollout
    collector = Collector(
        env, learner.policy, frames_per_batch=size, total_frames=decisions
    )
    for number, batch in enumerate(collector, start=1):
        share[0] = number * size / decisions
        yield number * size, batch, learner.extend(batch), test
    collector.shutdown()
    if judge is not None:
        judge.close()


def run(task: str, loss: str, seed: int, write: Callable[[Row], None]) -> None:
    """One run; ``write`` gets its rows."""
    decisions, every = TASKS[task].decisions, TASKS[task].every
    rewards, heads = [], []
    for done, batch, measured, test in learn(task, loss, seed):
        rewards.append(float(batch["next", "reward"].mean()))
        heads.append([measured.get(name, math.nan) for name in HEADS])
        if done % every == 0 or done >= decisions:
            judged = torch.tensor(heads).nanmean(0).tolist()
            row: Row = {"task": task, "learner": loss, "seed": seed, "decisions": done}
            row["reward"] = 100 * sum(rewards) / len(rewards)
            write(row | dict(zip(HEADS, judged, strict=True)) | test())
            rewards, heads = [], []


def run_random(task: str, seed: int) -> Row:
    """What random actions get."""
    settings = settings_of(task, TASKS[task].learners[0], seed)
    world, envs = world_of(task, settings), TASKS[task].random_envs
    env = world.make_env(batch_size=envs, seed=seed)
    policy = RandomPolicy(env.action_spec.space.n, seed=seed)
    steps = env.rollout(TASKS[task].length, policy, break_when_any_done=False)
    env.close()
    row: Row = {"task": task, "learner": "random", "seed": seed, "decisions": 0}
    if task in GAMES:
        return row | {"reward": float(last_rewards(steps).mean())}
    if task == "maze":
        return row | {"reward": 100 * float(steps["next", "reward"].mean())}
    return row | measure_rooms(steps)


def draw(rows: list[Row], path: Path) -> None:
    """The means over the seeds and the range of them, a panel a task."""
    table = pd.DataFrame(rows)
    tasks = table["task"].unique()
    figure = Figure(figsize=(4.2 * len(tasks), 3.4), layout="constrained")
    row = figure.subplots(1, len(tasks), squeeze=False)[0]
    for axes, task in zip(row, tasks, strict=True):
        part = table[table["task"] == task]
        for name, own in part.groupby("learner", sort=False):
            reward = own.groupby("decisions")["reward"]
            mean, low, high = reward.mean(), reward.min(), reward.max()
            if name == "random":
                axes.axhline(mean.iloc[0], ls="--", c="grey", label=name)
                continue
            (line,) = axes.plot(mean.index, mean, ".-", label=name)
            axes.fill_between(mean.index, low, high, alpha=0.2, color=line.get_color())
        per = "100 decisions" if task == "maze" else "an episode"
        axes.set(title=task, xlabel="decisions", ylabel=f"reward of {per}")
        axes.locator_params(axis="x", nbins=5)
        axes.legend()
    save_figure(figure, path)


def main() -> None:
    """Run every task with its learners and every seed; write the table, the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tasks", nargs="*", default=list(TASKS), choices=TASKS)
    parser.add_argument("--learners", nargs="+", default=LEARN, choices=LEARN)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    options = parser.parse_args()
    torch.set_num_threads(1)
    runs = [
        (task, seed, loss)
        for task, seed in product(options.tasks, options.seeds)
        for loss in ("random", *TASKS[task].learners)
        if loss in options.learners
    ]
    # Runs that are not made again keep their rows.
    rows: list[Row] = []
    if options.out.is_file():
        old = pd.read_csv(options.out)
        names = zip(old["task"], old["seed"], old["learner"], strict=True)
        rows = old[[name not in runs for name in names]].to_dict("records")

    def write(row: Row) -> None:
        rows.append({**row, "cpu_s": round(time.process_time() - began, 1)})
        table = pd.DataFrame(rows, columns=COLUMNS)
        table.to_csv(options.out, index=False, float_format="%.4g", lineterminator="\n")

    for task, seed, loss in runs:
        began = time.process_time()
        if loss == "random":
            write(run_random(task, seed))
        else:
            run(task, loss, seed, write)
        print(task, seed, loss, rows[-1], flush=True)
    draw(rows, options.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
