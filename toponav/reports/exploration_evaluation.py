"""Episodes by which an exploration is judged."""

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from toponav import keys
from toponav.builders import World, for_inference, seed_of
from toponav.config import ExploreConfig
from toponav.ground_truth import require_motion
from toponav.metrics import trace_episode
from toponav.plotting import FloorPlan, explored_frames, write_video
from toponav.reports.episodes import Progress, play_episodes
from toponav.runs import write_history
from toponav.training import (
    COVERAGE_LEVELS,
    Explorer,
    Row,
    make_explore_env,
    mean_of,
)

#: Policies that see nothing: blind baselines.
BASELINES = ("random", "sticky")
#: Sets the seeds of evaluations apart from those of training.
EVALUATION_SEED = 77
# Decisions from frame to frame of a video; `Evaluation` names it.
_EVERY = 6
#: What is kept of each decision where it is there, for tables and pictures.
_KEPT: list[NestedKey] = [keys.POSITION, keys.HEADING, keys.CELL, keys.COVERAGE]
_KEPT += [keys.DECISIONS_TO_COVERAGE, keys.IS_NEW_WAYPOINT, keys.SPURIOUS_WAYPOINT]
_KEPT += [keys.PLACES]


@dataclass
class Evaluation:
    """Episodes of one policy."""

    policy: str
    episodes: TensorDictBase  # [N, T] decisions: poses, coverage, waypoints, reward
    views: Tensor  # uint8 [V, H, W, 3]; every sixth that was seen in the first one
    reward_key: NestedKey  # of the reward that the explorer learned from, if computed

    def mean(self, column: str) -> float:
        """Mean of a column of `rows`."""
        return mean_of(self.rows(), column)

    def rows(self) -> list[Row]:
        """A row of ``evaluation.csv`` for each episode, until the world ends it."""
        later = self.episodes.get("next")
        ends = ends_of(later)
        last = later[torch.arange(len(later)), ends]
        table = pd.DataFrame({"policy": self.policy, "seed": range(len(later))})
        if (coverage := last.get(keys.COVERAGE, None)) is not None:
            table["coverage"] = coverage.flatten().tolist()
            names = [f"decisions_to_{round(100 * level)}" for level in COVERAGE_LEVELS]
            table[names] = last.get(keys.DECISIONS_TO_COVERAGE).tolist()
        if (places := last.get(keys.PLACES, None)) is not None:
            table["places"] = places.flatten().tolist()
        reward = later.get(self.reward_key, None)
        returns: float | list[float] = math.nan
        if reward is not None:
            until = torch.arange(reward.shape[1]) <= ends.unsqueeze(1)
            returns = (reward.flatten(1) * until).sum(1).tolist()
        table["intrinsic_return"] = returns
        rows: list[Row] = table.to_dict("records")
        return rows


def ends_of(later: TensorDictBase) -> Tensor:
    """The decision ``[N]`` that ended each episode of ``[N, T]``, T - 1 if none."""
    done = later.get(keys.DONE, None)
    if done is None:
        return torch.full(later.shape[:1], later.shape[1] - 1)
    ended: Tensor = done.flatten(1).clone()
    ended[:, -1] = True
    return ended.int().argmax(1)


def evaluate_policies(
    settings: ExploreConfig,
    world: World,
    explorer: Explorer,
    policies: Mapping[str, TensorDictModuleBase],
    progress: Progress | None = None,
) -> list[Evaluation]:
    """Play whole episodes, the same for all; the explorer's reward is computed.

    The blind baselines play ``evaluate.random_episodes``, the others
    ``evaluate.episodes``. ``progress`` is that of `play_episodes`.
    """
    evaluate, length = settings.evaluate, world.episode_length
    wanted = {
        name: evaluate.random_episodes if name in BASELINES else evaluate.episodes
        for name in policies
    }
    explorer = copy.deepcopy(explorer)
    if explorer.novelty is not None:
        for_inference(explorer.novelty, settings.model)
    reward = explorer.reward.reward_key
    played = play_episodes(
        lambda envs: make_explore_env(settings, world, explorer, envs=envs, seed=0),
        policies,
        wanted,
        length,
        seed=seed_of(settings.seed, EVALUATION_SEED),
        action_seed=seed_of(settings.seed, EVALUATION_SEED, 1),
        keep=_KEPT,
        keep_next=[*_KEPT, reward, keys.DONE],
        views=length + 1,
        progress=progress,
    )
    return [
        Evaluation(name, one.frames, one.views[::_EVERY].clone(), reward)
        for name, one in played.items()
    ]


def write_evaluation(
    folder: Path, evaluations: list[Evaluation], earlier: Sequence[Row] = ()
) -> list[Row]:
    """Write ``evaluation.csv``, the new episodes before earlier ones; returns all."""
    rows = [row for one in evaluations for row in one.rows()]
    rows += [row for row in earlier if row not in rows]
    write_history(folder / "evaluation.csv", rows)
    return rows


def summarize_evaluation(world: str, rows: list[Row]) -> str:
    """How the explorer compares with blind baselines, in a few lines.

    Examples:
        >>> def row(policy, coverage, decisions):
        ...     found = {"policy": policy, "coverage": coverage}
        ...     return found | {"decisions_to_90": decisions}
        >>> rows = [row("best", 0.75, -1), row("best", 1.0, 400)]
        >>> rows.append(row("random", 0.4, -1))
        >>> print(summarize_evaluation("maze3", rows))
        maze3: best policy covers 87.5 % of the maze (1 of 2 episodes reach 90 %, after
        400 decisions on average); random covers 40.0 % (0 of 1): 2.2 times as much
    """
    table = pd.DataFrame(rows)
    if "coverage" not in table:
        measures = {"places": "places visited", "intrinsic_return": "intrinsic return"}
        by_policy, texts = table.groupby("policy", sort=False), []
        for name, measure in measures.items():
            if name in table:
                means = by_policy[name].mean().items()
                each = "; ".join(f"{policy} {value:.1f}" for policy, value in means)
                texts.append(f"{measure} per episode: {each}")
        return f"{world}: {'; '.join(texts)}"
    # NaN for an episode that did not get there.
    table["soon"] = table["decisions_to_90"].where(table["decisions_to_90"] >= 0)
    found = table.groupby("policy", sort=False).agg(
        cover=("coverage", "mean"),
        after=("soon", "mean"),
        reached=("soon", "count"),
        episodes=("soon", "size"),
    )
    first, *others = found.itertuples()
    after = f", after {first.after:,.0f} decisions on average" if first.reached else ""
    text = (
        f"{world}: {first.Index} policy covers {100 * first.cover:.1f} % of the maze "
        f"({first.reached} of {first.episodes} episodes reach 90 %{after})"
    )
    for one in others:
        text += f"; {one.Index} covers {100 * one.cover:.1f} % "
        text += f"({one.reached} of {one.episodes})"
        if one.Index == "random" and one.cover:
            text += f": {first.cover / one.cover:.1f} times as much"
    return text


def write_episode_video(folder: Path, world: World, evaluation: Evaluation) -> None:
    """Write ``episode.mp4``: the first episode of an evaluation, view beside plan.

    Without ground truth there is no plan, and the video shows the views until the
    world ends the episode.
    """
    views = evaluation.views.numpy()
    end = int(ends_of(evaluation.episodes["next"])[0])
    frames: Iterable[Any] = views[: end // _EVERY + 1]
    if world.layout is not None:
        trace = trace_episode(evaluation.episodes[0], reward=evaluation.reward_key)
        frames = explored_frames(trace, views, plan=make_plan(world), every=_EVERY)
    write_video(folder / "episode.mp4", frames)


def make_plan(world: World) -> FloorPlan:
    """The plan of a maze to draw on; slots that are closed are no floor."""
    assert world.layout is not None
    cell_size = require_motion(world.spec).cell_size
    slots, closed = world.layout.slots, world.blocked
    return FloorPlan(world.floor, cell_size=cell_size, slots=slots, closed=closed)
