"""How agents walk to pictures, in worlds of positions without a plan."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import InitTracker, TransformedEnv

from toponav.builders import World, collect_rollout, load_knowledge, seed_of
from toponav.config import NavigateConfig, require
from toponav.keys import DONE, GOAL_VIEWS, PIXELS, POSITION
from toponav.methods import make_world, read_explored
from toponav.methods.navigators import CHOSEN, TopologicalConfig, make_navigator
from toponav.metrics import decisions_to_reach
from toponav.policies import RandomPolicy, StickyPolicy
from toponav.runs import write_text

# Apart from the seeds of episodes in mazes; environments that walk for pictures.
_WALK, _EPISODES, _CHOICE, _WALKERS = 77, 78, 79, 4


@dataclass(frozen=True)
class PictureGoals:
    """What E episodes ask for."""

    views: Tensor  # uint8 [E, V, H, W, 3]
    squares: Tensor  # int64 [E, 2], where they were taken: no agent knows it


class _ShowGoals(TensorDictModuleBase):
    """A policy that is shown the pictures of its environments' goals."""

    def __init__(self, policy: TensorDictModuleBase, views: Tensor) -> None:
        super().__init__()
        self.policy, self.views = policy, views
        self.in_keys = [key for key in policy.in_keys if key != GOAL_VIEWS]
        self.out_keys = policy.out_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        found: TensorDictBase = self.policy(tensordict.set(GOAL_VIEWS, self.views))
        return found


def write_picture_walks(settings: NavigateConfig, folder: Path) -> str:
    """Play the episodes, write ``episodes.csv`` and ``summary.csv``; a line a policy.

    Raises:
        SettingsError: if the exploration has no map or its world no positions, or what
            is asked for needs the plan of a maze.
    """
    world = _world_of(settings)
    assert isinstance(settings.navigator, TopologicalConfig)
    knowledge = load_knowledge(Path(str(settings.run)), world.spec)
    goals, episodes = choose_goals(settings, world), settings.evaluate.episodes
    actions, seed = world.spec.num_actions, settings.seed
    policies: dict[str, TensorDictModuleBase] = {
        CHOSEN: make_navigator(settings.navigator, knowledge=knowledge, seed=seed),
        "random": RandomPolicy(actions, seed=seed),
        "sticky": StickyPolicy(actions, seed=seed),
    }
    tables = []
    for name, policy in policies.items():
        # The same starts for all: a new batch of environments of the same seed.
        env = world.make_env(
            batch_size=episodes, seed=seed_of(seed, _EPISODES), privileged=True
        )
        with closing(TransformedEnv(env, InitTracker())) as shown:
            frames = collect_rollout(
                shown,
                _ShowGoals(policy, goals.views),
                world.episode_length,
                keep=(),
                keep_next=[POSITION, DONE],
            ).frames
        tables.append(judge_walks(frames, goals.squares, size_of(world), policy=name))
    table = pd.concat(tables)
    write_text(folder / "episodes.csv", table.to_csv(index=False))
    rows = [_summary(name, own) for name, own in table.groupby("policy", sort=False)]
    write_text(folder / "summary.csv", pd.DataFrame(rows).to_csv(index=False))
    line = "{policy}: came to the place of {reached} of {episodes} pictures\n"
    return "".join(line.format(**row) for row in rows)


def choose_goals(settings: NavigateConfig, world: World) -> PictureGoals:
    """Squares that a random walk has entered, one an episode, and pictures from there.

    No episode begins in the square of its goal.
    """
    episodes, seed = settings.evaluate.episodes, settings.seed
    starts = seed_of(seed, _EPISODES)
    with closing(
        world.make_env(batch_size=episodes, seed=starts, privileged=True)
    ) as env:
        begin = squares_of(env.reset()[POSITION], size_of(world))
    walk = seed_of(seed, _WALK)
    with closing(
        world.make_env(batch_size=_WALKERS, seed=walk, privileged=True)
    ) as env:
        walker = StickyPolicy(world.spec.num_actions, seed=walk)
        kept = [PIXELS, POSITION]
        frames = collect_rollout(env, walker, world.episode_length, keep=kept).frames
    frames = frames.reshape(-1)
    entered = squares_of(frames[POSITION], size_of(world))
    draws = torch.Generator().manual_seed(seed_of(seed, _CHOICE))
    chosen = []
    for start in begin:
        away = (entered != start).any(-1).nonzero().flatten()
        rule = "world.square must be so small that a walk enters two squares"
        require(len(away) > 0, rule, size_of(world))
        # A square, each as likely, and pictures from it.
        squares, number = entered[away].unique(dim=0, return_inverse=True)
        drawn = torch.randint(len(squares), (), generator=draws)
        there = away[number == drawn]
        order = torch.randint(len(there), (settings.goals.views,), generator=draws)
        chosen.append(there[order])
    rows = torch.stack(chosen)
    return PictureGoals(frames[PIXELS][rows], entered[rows[:, 0]])


def judge_walks(
    frames: TensorDictBase, squares: Tensor, size: float, *, policy: str
) -> pd.DataFrame:
    """Whether each row of frames ``[E, T]`` came to its square in its first episode.

    ``decisions`` is how many it took, -1 if it did not.
    """
    later = frames["next"]
    over = later[DONE].squeeze(-1).cumsum(1) - later[DONE].squeeze(-1).long() > 0
    here = squares_of(later[POSITION], size)
    there = (here == squares.unsqueeze(1)).all(-1) & ~over
    reached = there.any(1)
    first = there.int().argmax(1) + 1
    return pd.DataFrame(
        {
            "policy": policy,
            "episode": range(len(squares)),
            "goal_x": squares[:, 0].tolist(),
            "goal_y": squares[:, 1].tolist(),
            "reached": reached.int().tolist(),
            "decisions": first.masked_fill(~reached, -1).tolist(),
        }
    )


def squares_of(position: Tensor, size: float) -> Tensor:
    """The squares of a side, int64 ``[*B, 2]``, in which positions lie."""
    return (position / size).floor().long()


def size_of(world: World) -> float:
    """Side of the squares that count as places."""
    assert world.spec.place_size is not None
    return world.spec.place_size


def _summary(policy: object, table: pd.DataFrame) -> Mapping[str, float | str]:
    # Of all episodes: those that arrive are the easy ones.
    median, _ = decisions_to_reach(table.decisions)
    return {
        "policy": str(policy),
        "episodes": len(table),
        "reached": int(table.reached.sum()),
        "median_decisions": median,
    }


def _world_of(settings: NavigateConfig) -> World:
    """The world of the exploration; SettingsError if no walk there can be judged."""
    explored = read_explored(str(settings.run), setting="run")
    where = f"in world={explored.world.name}"
    name = settings.navigator.name
    rule = f"navigator must be topological {where}, whose maps have no poses"
    require(isinstance(settings.navigator, TopologicalConfig), rule, name)
    rule = f"evaluate.trained and maze.blocked must be empty {where}"
    asked = [*settings.evaluate.trained, *settings.maze.blocked]
    require(not asked, rule, asked)
    world = make_world(explored)
    rule = "run must name an exploration with world.position, by which walks are judged"
    require(world.spec.has_positions, rule, f"'{settings.run}' without")
    return world
