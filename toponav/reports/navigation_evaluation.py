"""Episodes of navigators and of those they are compared with, and their numbers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from tqdm import tqdm

from toponav.builders import (
    GoalPlaces,
    GroundTruth,
    collect_rollout,
    make_navigation_env,
    seed_of,
)
from toponav.config import NavigateConfig
from toponav.graph import Map
from toponav.keys import GOAL_VIEWS
from toponav.metrics import (
    TRACE_KEYS,
    TRACE_NEXT_KEYS,
    NavigationTrace,
    aligned_table,
    bootstrap,
    classify_decisions,
    detection_delays,
    first_goal,
    judge_cuts,
    mean_detour,
    measure_legs,
    slow_legs,
    success_weighted_by_length,
    trace_navigation,
)

Row = dict[str, Any]
# Mazes side by side at most; apart from the seeds of the walk for pictures.
_MAX_ENVS = 32
_EPISODES = 66
#: Decisions within which success is reported.
WITHIN = (250, 500, 1250, 5000)


@dataclass(frozen=True)
class NavigationEpisodes:
    """The episodes of one policy.

    Args:
        policy: its name.
        trace: what happened.
        legs: the table of `measure_legs`.
        views: uint8 ``[V, H, W, 3]``; what the first episode showed at its beginning.
        goal: uint8 ``[H, W, 3]``; the first picture of its goal.
        map: on which the policy plans, if it plans on one.
    """

    policy: str
    trace: NavigationTrace
    legs: pd.DataFrame
    views: Tensor
    goal: Tensor
    map: Map | None = None


def play_policies(
    config: NavigateConfig,
    truth: GroundTruth,
    places: GoalPlaces,
    policies: Mapping[str, TensorDictModuleBase],
) -> list[NavigationEpisodes]:
    """Play whole episodes; all policies meet the same mazes, starts and goals.

    Raises:
        EngineError: if the engine cannot start.
    """
    wanted, length = config.evaluate.episodes, config.maze.episode_length
    envs = min(wanted, _MAX_ENVS)
    rounds = math.ceil(wanted / envs)
    env = make_navigation_env(config, places, envs=envs, seed=0)
    bar = tqdm(total=len(policies) * rounds * envs * length, unit="decision")
    found = []
    try:
        for name, policy in policies.items():
            bar.set_description(name)
            # The same episodes for each: scenes follow from seed and row.
            env.set_seed(seed_of(config.seed, _EPISODES))
            parts = [
                collect_rollout(
                    env,
                    policy,
                    length,
                    keep=TRACE_KEYS,
                    keep_next=TRACE_NEXT_KEYS,
                    views=config.video.decisions,
                    progress=bar.update,
                )
                for _ in range(rounds)
            ]
            frames = torch.cat([part.frames for part in parts])[:wanted]
            trace = trace_navigation(frames)
            found.append(
                NavigationEpisodes(
                    name,
                    trace,
                    measure_legs(trace, truth.distances),
                    views=parts[0].views,
                    goal=parts[0].start[GOAL_VIEWS][0],
                    map=getattr(policy, "map", None),
                )
            )
    finally:
        bar.close()
        env.close()
    return found


def episode_table(episodes: NavigationEpisodes) -> pd.DataFrame:
    """A row of ``episodes.csv`` for each episode."""
    trace = episodes.trace
    return pd.DataFrame(
        {
            "policy": episodes.policy,
            "episode": np.arange(len(trace)),
            "goals": trace.reached.sum(1),
            "reward": trace.reward.sum(1),
            "first_goal": first_goal(trace),
            "spl": success_weighted_by_length(episodes.legs),
            "replans": (trace.cut_from >= 0).sum(1),
            "lost": trace.lost.mean(1),
        }
    )


def summary_row(
    episodes: NavigationEpisodes,
    truth: GroundTruth,
    places: GoalPlaces,
    *,
    slow: int,
) -> Row:
    """A row of ``summary.csv``: means with their 95 % intervals, and what went wrong.

    Cuts and faults are of an agent with a map; they are left out for the others.

    Args:
        episodes: of one policy.
        truth: about the maze.
        places: where goals were.
        slow: decisions to a goal beyond which the reason is looked for.
    """
    table, trace = episode_table(episodes), episodes.trace
    measured = {name: table[name] for name in ("goals", "reward", "spl", "replans")}
    first = table["first_goal"]
    for time in [t for t in WITHIN if t <= trace.decisions] or [trace.decisions]:
        measured[f"success_{time}"] = (first >= 0) & (first <= time)
    row: Row = {"policy": episodes.policy, "episodes": len(trace)}
    for name, values in measured.items():
        found = bootstrap(values)
        row |= {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}
    row["detour"] = mean_detour(episodes.legs, shortest=truth.distances.cell_size)
    row |= _fault_numbers(trace, truth, slow=slow)
    row["places_without_picture"] = places.num_without
    return row


def _fault_numbers(trace: NavigationTrace, truth: GroundTruth, *, slow: int) -> Row:
    distances = truth.distances
    waypoints = np.asarray(truth.poses[:, :2], np.float64)
    cuts = judge_cuts(trace, distances, waypoints)
    delays = detection_delays(trace, distances, cuts)
    numbers: Row = {
        f"cuts_{verdict}": int((cuts.verdict == verdict).sum())
        for verdict in ("blockage", "false_edge", "false_block")
    }
    numbers["detection_delay"] = float(np.median(delays)) if len(delays) else math.nan
    has_map = bool((trace.place >= 0).any())
    faults = classify_decisions(trace, distances, waypoints)
    slow_by = slow_legs(trace, faults, limit=slow)
    for number, name in enumerate(slow_by):
        share = float((faults == number).mean()) if has_map else math.nan
        numbers[f"decisions_{name}"] = share
        numbers[f"slow_{name}"] = slow_by[name] if has_map else math.nan
    return numbers


def markdown_summary(rows: Sequence[Row], *, title: str) -> str:
    """All numbers as a table, a policy a column, with 95 % intervals.

    Examples:
        >>> row = {"policy": "oracle", "goals": 133.0, "goals_low": 130.0}
        >>> row |= {"goals_high": 136.25, "detour": 1.25}
        >>> print(markdown_summary([row], title="maze1"))
        maze1
        <BLANKLINE>
        |        | oracle             |
        |--------|--------------------|
        | goals  | 133 (130 to 136.2) |
        | detour | 1.25               |
        <BLANKLINE>
    """
    names = [
        name
        for name in rows[0]
        if name != "policy" and not name.endswith(("_low", "_high"))
    ]
    table = pd.DataFrame({"": names})
    for row in rows:
        table[row["policy"]] = [_cell(row, name) for name in names]
    return f"{title}\n\n{aligned_table(table)}"


def _cell(row: Row, name: str) -> str:
    middle, low, high = (
        float(row.get(f"{name}{end}", math.nan)) for end in ("", "_low", "_high")
    )
    if math.isnan(middle):
        return ""
    if math.isnan(low) or low == high:
        return f"{middle:.4g}"
    return f"{middle:.4g} ({low:.4g} to {high:.4g})"
