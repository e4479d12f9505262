r"""DQN and DRQN on two small games, Nav A3C and D2L in a maze with a fixed goal.

    PYTHONPATH=. python benchmarks/sanity_navigation.py \
        --out results/sanity_navigation.csv

``catch`` is of DQN's kind: all that matters is in view. In ``recall`` a sign is shown
once, and six to eight decisions later its action is right: more than DQN's four views,
less than DRQN's ten. In ``maze``, a small one on the engine, the goal never moves. The
learners are those of ``recipes/explore.py``, in one process. A row has the mean reward
of an episode (games: 64 episodes without random actions; 1 is the best, -1 the worst)
or of 100 decisions (maze: those since the last row, 10 for the goal), and what D2L's
heads say of decisions that nothing was learned from yet. A figure is beside the table.
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
from hydra import compose, initialize_config_dir
from matplotlib.figure import Figure
from omegaconf import OmegaConf
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from toponav.builders import Learner, make_env
from toponav.config import ExploreConfig, TrainingError
from toponav.keys import POLICY_PIXELS
from toponav.methods import LEARNERS, make_reward, register
from toponav.methods.worlds import MazeWorld
from toponav.plotting import save_figure
from toponav.policies import RandomPolicy
from toponav.training import Explorer, make_explore_env
from toponav.worlds import WorldSpec

CONF = Path(__file__).parent.parent / "conf"
SIDE, CELL = 36, 4


class Game(EnvBase):
    """A batch of games that are seen from above, 36 x 36 pixels."""

    num_actions: int
    numbers: int  # that a state consists of

    def __init__(self, num_envs: int, seed: int) -> None:
        super().__init__(batch_size=[num_envs])
        self.generator = torch.Generator().manual_seed(seed)
        shape = (num_envs, 1)
        view = (num_envs, SIDE, SIDE, 3)
        self.observation_spec = Composite(
            {
                POLICY_PIXELS: Unbounded(view, dtype=torch.uint8),
                "state": Unbounded((num_envs, self.numbers), dtype=torch.int64),
            },
            shape=[num_envs],
        )
        self.action_spec = Categorical(self.num_actions, shape=(num_envs,))
        self.reward_spec = Unbounded(shape)
        flag = Binary(1, shape, dtype=torch.bool)
        names = ("done", "terminated", "truncated")
        self.done_spec = Composite({name: flag for name in names}, shape=[num_envs])

    def start(self, num: int) -> Tensor:
        """States at an episode's start, int64 ``[N, K]``."""
        raise NotImplementedError

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """States after a decision, rewards, and which episodes are over."""
        raise NotImplementedError

    def draw(self, state: Tensor) -> Tensor:
        """Views ``[N, 36, 36, 3]``."""
        raise NotImplementedError

    def numbers_below(self, bound: int, num: int) -> Tensor:
        """Draws from [0, bound)."""
        return torch.randint(bound, (num,), generator=self.generator)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object):
        # TorchRL keeps what goes on.
        state = self.start(self.batch_size[0])
        flags = dict.fromkeys(("done", "terminated", "truncated"), _no(state))
        entries = {POLICY_PIXELS: self.draw(state), "state": state, **flags}
        return TensorDict(entries, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        state, reward, over = self.move(tensordict["state"], tensordict["action"])
        over = over.unsqueeze(-1)
        flags = {"done": over, "terminated": over, "truncated": _no(state)}
        entries = {POLICY_PIXELS: self.draw(state), "state": state, **flags}
        entries["reward"] = reward.float().unsqueeze(-1)
        return TensorDict(entries, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(seed or 0)


def _no(state: Tensor) -> Tensor:
    return torch.zeros(len(state), 1, dtype=torch.bool)


class Catch(Game):
    """A ball falls through nine rows; what matters is to be below it at the end."""

    num_actions, numbers = 3, 3

    def start(self, num: int) -> Tensor:
        ball, hand = self.numbers_below(9, num), torch.full((num,), 4)
        return torch.stack([torch.zeros_like(ball), ball, hand], -1)

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        row, ball, hand = state.unbind(-1)
        row, hand = row + 1, (hand + action - 1).clamp(0, 8)
        over = row == 8
        reward = torch.where(hand == ball, 1, -1) * over
        return torch.stack([row, ball, hand], -1), reward, over

    def draw(self, state: Tensor) -> Tensor:
        row, ball, hand = state.unbind(-1)
        small = torch.zeros(len(state), 9, 9, dtype=torch.uint8)
        every = torch.arange(len(state))
        small[every, 8, hand] = 127
        small[every, row, ball] = 255
        large = small.repeat_interleave(CELL, 1).repeat_interleave(CELL, 2)
        return large.unsqueeze(-1).repeat(1, 1, 1, 3)


class Recall(Game):
    """A sign, a way without signs, and a junction where the sign's action is right."""

    num_actions, numbers = 2, 3

    def start(self, num: int) -> Tensor:
        sign, length = self.numbers_below(2, num), 6 + self.numbers_below(3, num)
        return torch.stack([sign, torch.zeros_like(sign), length], -1)

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        sign, now, length = state.unbind(-1)
        over = now == length
        reward = torch.where(action == sign, 1, -1) * over
        return torch.stack([sign, now + 1, length], -1), reward, over

    def draw(self, state: Tensor) -> Tensor:
        sign, now, length = state.unbind(-1)
        views = torch.full((len(state), SIDE, SIDE, 3), 60, dtype=torch.uint8)
        half = torch.arange(SIDE) // (SIDE // 2)
        shown = (now == 0).unsqueeze(-1) & (half == sign.unsqueeze(-1))
        views[..., 0] = torch.where(shown.unsqueeze(1), 255, 60)
        views[now == length] = 255
        return views


class FixedGoal(MazeWorld):
    """A maze whose goal is in the same cell in all episodes."""

    def make_env(self, *, senses=(), privileged=False, batch_size, seed, **_: object):
        assert self.layout is not None
        return make_env(
            self.maze,
            engine=self.engine,
            batch_size=batch_size,
            seed=seed,
            privileged=privileged,
            goal_cells=[self.layout.cells[-1]],
            depth=(20, 18) if "depth" in senses else None,
            velocity="velocity" in senses,
        )


class GameWorld:
    """What a learner asks of a world."""

    senses = ()

    def __init__(self, game: Game) -> None:
        self.name, self.layout = type(game).__name__, None
        actions = tuple(f"action {number}" for number in range(game.num_actions))
        self.spec = WorldSpec(view_size=(SIDE, SIDE), actions=actions)


GAMES: dict[str, type[Game]] = {"catch": Catch, "recall": Recall}
#: Of each task: its learners, decisions, decisions of a row, and settings.
TASKS: dict[str, tuple[tuple[str, ...], int, int, list[str]]] = {
    "catch": (
        ("dqn", "drqn"),
        12_800,
        1_280,
        ["collect.envs=16", "policy.hidden=64", "loss.reward_scale=1"],
    ),
    "recall": (
        ("dqn", "drqn"),
        15_360,
        1_280,
        ["collect.envs=16", "policy.hidden=64", "loss.reward_scale=1"],
    ),
    "maze": (
        ("nav_a3c", "nav_a3c_d2l"),
        128_000,
        12_800,
        [
            *("collect.envs=16", "maze=random", "maze.rows=2", "maze.cols=2"),
            *(
                "maze.loops=1",
                "maze.goal=true",
                "maze.episode_length=400",
                "policy.hidden=128",
            ),
            *("loss.rollout=20", "loss.lr=0.002", "loss.eps=0.001"),
            *("loss.entropy_coeff=0.01", "loss.first_hidden=32"),
        ],
    ),
}
#: Settings of the value learners in both games.
VALUES = ["loss.rollout=20", "loss.replay=10000", "loss.warmup=1000", "loss.every=4"]
VALUES += ["loss.target_every=200", "loss.lr=0.0005", "loss.epsilon_until=0.4"]
HEADS = ("depth_accuracy", "depth_chance", "loop_found", "loop_false")
NOTHING = dict.fromkeys(HEADS, math.nan)
Row = dict[str, Any]


def settings_of(task: str, loss: str, seed: int) -> ExploreConfig:
    """The settings of one run."""
    words = ["reward=extrinsic", "policy.input=pixels", f"policy.view_size={SIDE}"]
    words += [f"seed={seed}", "collect.workers=1", "evaluate.episodes=1"]
    words += [f"loss={loss}", *TASKS[task][-1], *(VALUES if task in GAMES else [])]
    if loss == "drqn":
        # Slices of ten decisions: as many decisions as DQN's stacks in an update.
        words += ["loss.batch=16", "loss.every=8"]
    with initialize_config_dir(str(CONF.resolve()), version_base="1.3"):
        found: Any = OmegaConf.to_object(compose("explore", overrides=words))
    assert isinstance(found, ExploreConfig)
    return found.resolved(None)


def check(figures: Mapping[str, float], update: int) -> None:
    """Stop at a number that is none."""
    if bad := [name for name, value in figures.items() if not math.isfinite(value)]:
        raise TrainingError(f"{bad[0]} must be finite, got another in update {update}")


def make_learner(settings: ExploreConfig, world: Any, share: list[float]) -> Learner:
    """The learner of one run; ``share`` holds how much of it is over."""
    return LEARNERS[settings.loss.name](
        settings, world, reward="reward", check=check, progress=lambda: share[0]
    )


def learn(
    task: str, loss: str, seed: int
) -> Iterator[tuple[int, TensorDictBase, Mapping[str, float], Callable[[], float]]]:
    """Batches of one run: decisions so far, the batch, what was measured, a test."""
    torch.manual_seed(seed)
    settings, share = settings_of(task, loss, seed), [0.0]
    decisions, envs = TASKS[task][1], settings.collect.envs
    if task in GAMES:
        learner = make_learner(settings, GameWorld(GAMES[task](1, 0)), share)

        def make(num: int, start: int) -> EnvBase:
            primer = learner.policy.make_tensordict_primer()
            game = GAMES[task](num, start)
            return TransformedEnv(game, Compose(InitTracker(), primer))

        env, judge = make(envs, seed), make(64, 1000 + seed)

        def test() -> float:
            with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
                steps = judge.rollout(9, learner.policy, break_when_any_done=False)
            # The first episode of each.
            first = steps["next", "done"].cumsum(1).cumsum(1) == 1
            return float(steps["next", "reward"][first].mean())

    else:
        world = FixedGoal(settings)
        learner = make_learner(settings, world, share)
        explorer = Explorer(learner.policy, make_reward(settings, world, None), None)
        arguments = {"envs": envs, "seed": seed, "stagger": True, "teach": True}
        env = make_explore_env(settings, world, explorer, **arguments)

        def test() -> float:
            return math.nan

    size = envs * settings.loss.rollout
    collector = Collector(
        env, learner.policy, frames_per_batch=size, total_frames=decisions
    )
    for number, batch in enumerate(collector, start=1):
        share[0] = number * size / decisions
        yield number * size, batch, learner.extend(batch), test
    collector.shutdown()


def run(task: str, loss: str, seed: int, write: Callable[[Row], None]) -> None:
    """One run; ``write`` gets its rows."""
    _, decisions, every, _ = TASKS[task]
    rewards, heads = [], []
    for done, batch, measured, test in learn(task, loss, seed):
        rewards.append(float(batch["next", "reward"].mean()))
        heads.append([measured.get(name, math.nan) for name in HEADS])
        if done % every == 0 or done >= decisions:
            reward = test() if task in GAMES else 100 * sum(rewards) / len(rewards)
            judged = torch.tensor(heads).nanmean(0).tolist()
            write(
                {
                    **{"task": task, "learner": loss, "seed": seed, "decisions": done},
                    **{"reward": reward, **dict(zip(HEADS, judged, strict=True))},
                }
            )
            rewards, heads = [], []


def run_random(task: str, seed: int) -> Row:
    """What random actions get."""
    settings = settings_of(task, TASKS[task][0][0], seed)
    if task in GAMES:
        env: EnvBase = GAMES[task](512, seed)
        length = 9
    else:
        length, arguments = 400, {"batch_size": settings.collect.envs, "seed": seed}
        env = FixedGoal(settings).make_env(**arguments)
    policy = RandomPolicy(env.action_spec.space.n, seed=seed)
    steps = env.rollout(length, policy, break_when_any_done=False)
    reward = steps["next", "reward"]
    if task in GAMES:
        first = steps["next", "done"].cumsum(1).cumsum(1) == 1
        rewards = float(reward[first].mean())
    else:
        rewards = 100 * float(reward.mean())
    env.close()
    found = {"task": task, "learner": "random", "seed": seed, "decisions": 0}
    return {**found, "reward": rewards, **NOTHING}


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
        per = "an episode" if task in GAMES else "100 decisions"
        axes.set(title=task, xlabel="decisions", ylabel=f"reward of {per}")
        axes.legend()
    save_figure(figure, path)


def main() -> None:
    """Run every task with its learners and every seed; write the table, the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), choices=TASKS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    options = parser.parse_args()
    torch.set_num_threads(1)
    register()
    # Tasks that are not run again keep their rows.
    rows: list[Row] = []
    if options.out.is_file():
        old = pd.read_csv(options.out)
        rows = old[~old["task"].isin(options.tasks)].to_dict("records")

    def write(row: Row) -> None:
        rows.append({**row, "cpu_s": round(time.process_time() - began, 1)})
        table = pd.DataFrame(rows)
        table.to_csv(options.out, index=False, float_format="%.4g", lineterminator="\n")

    for task, seed in product(options.tasks, options.seeds):
        began = time.process_time()
        write(run_random(task, seed))
        for loss in TASKS[task][0]:
            began = time.process_time()
            run(task, loss, seed, write)
            print(task, seed, loss, rows[-1], flush=True)
    draw(rows, options.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
