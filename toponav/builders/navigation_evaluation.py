"""Episodes of navigators and of those they are compared with, and their numbers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from tqdm import tqdm

from toponav.builders.episode_log import Row
from toponav.builders.explore_collector import seed_of
from toponav.builders.navigation import Explored
from toponav.builders.navigation_goals import GoalPlaces, make_navigation_env
from toponav.config import NavigateConfig
from toponav.evaluation import (
    TRACE_KEYS,
    TRACE_NAVIGATION_KEYS,
    TRACE_NEXT_KEYS,
    LegMeasures,
    NavigationTrace,
    PathFollower,
    RandomPolicy,
    bootstrap,
    classify_decisions,
    detection_delays,
    first_goal,
    goals_reached,
    judge_cuts,
    mean_detour,
    measure_legs,
    slow_legs,
    success_weighted_by_length,
    success_within,
    trace_navigation,
)
from toponav.graph import Navigator
from toponav.keys import GOAL_VIEWS, PIXELS

# Mazes side by side at most; apart from the seeds of the walk for pictures.
_MAX_ENVS = 32
_EPISODES = 66
#: Decisions within which success is told.
WITHIN = (250, 500, 1250, 5000)


@dataclass
class Played:
    """The episodes of one policy.

    Args:
        policy: its name.
        trace: what happened.
        measures: of its legs.
        views: uint8 ``[T, H, W, 3]``; what the first episode saw at its beginning.
        goal: uint8 ``[H, W, 3]``; the first picture of its goal.
    """

    policy: str
    trace: NavigationTrace
    measures: LegMeasures
    views: Tensor
    goal: Tensor


def make_policies(
    config: NavigateConfig, explored: Explored, navigator: Navigator
) -> dict[str, TensorDictModuleBase]:
    """Who plays, by name, in the order of ``evaluate.policies``."""
    every: dict[str, TensorDictModuleBase] = {
        "navigator": navigator,
        "oracle": PathFollower(
            torch.as_tensor(explored.layout.open_mask),
            slot_cells=list(explored.layout.slots.values()),
            seed=config.seed,
        ),
        "random": RandomPolicy(seed=config.seed),
    }
    return {name: every[name] for name in config.evaluate.policies}


def play_policies(
    config: NavigateConfig,
    explored: Explored,
    places: GoalPlaces,
    policies: Mapping[str, TensorDictModuleBase],
) -> list[Played]:
    """Play whole episodes; all policies meet the same mazes, starts and goals.

    Raises:
        EngineError: if the engine cannot start.
    """
    wanted, length = config.evaluate.episodes, config.maze.episode_length
    envs = min(wanted, _MAX_ENVS)
    rounds = math.ceil(wanted / envs)
    env = make_navigation_env(config.maze, places, envs=envs, seed=0)
    bar = tqdm(total=len(policies) * rounds * envs * length, unit="decision")
    found = []
    try:
        for name, policy in policies.items():
            bar.set_description(name)
            # The same episodes for each: scenes follow from seed and row.
            env.set_seed(seed_of(config.seed, _EPISODES))
            shown = config.video.decisions
            parts = [play(env, policy, length, bar, views=shown) for _ in range(rounds)]
            episodes = torch.cat([part[0] for part in parts])[:wanted]
            trace = trace_navigation(episodes)
            measures = measure_legs(trace, explored.ways)
            found.append(Played(name, trace, measures, *parts[0][1:]))
    finally:
        bar.close()
        env.close()
    return found


@torch.no_grad()
def play(
    env: EnvBase, policy: TensorDictModuleBase, decisions: int, bar: tqdm, *, views: int
) -> tuple[TensorDictBase, Tensor, Tensor]:
    """One episode of each row, ``[E, T]``; first views and goal of the first row."""
    now, steps = env.reset(), []
    seen, goal = [now[PIXELS][0].clone()], now[GOAL_VIEWS][0, 0].clone()
    for decision in range(decisions):
        step, following = env.step_and_maybe_reset(policy(now))
        kept = step.select(*TRACE_KEYS, *TRACE_NAVIGATION_KEYS, strict=False)
        kept["next"] = step["next"].select(*TRACE_NEXT_KEYS)
        steps.append(kept)
        if decision + 1 < views:
            seen.append(following[PIXELS][0].clone())
        now = following
        bar.update(len(step))
    return torch.stack(steps, 1), torch.stack(seen), goal


def episode_rows(played: Played) -> list[Row]:
    """A row of ``episodes.csv`` for each episode."""
    trace = played.trace
    spl = success_weighted_by_length(played.measures)
    goals, first = goals_reached(trace), first_goal(trace)
    return [
        {
            "policy": played.policy,
            "episode": number,
            "goals": int(goals[number]),
            "reward": float(trace.reward[number].sum()),
            "first_goal": int(first[number]),
            "spl": float(spl[number]),
            "replans": int((trace.cut_from[number] >= 0).sum()),
            "lost": float(trace.lost[number].mean()),
        }
        for number in range(len(trace))
    ]


def summary_row(played: Played, explored: Explored, config: NavigateConfig) -> Row:
    """A row of ``summary.csv``: means with their 95 % intervals, and what went wrong.

    Cuts and faults are of an agent with a map; they are left out for the others.
    """
    rows, trace = episode_rows(played), played.trace
    row: Row = {"policy": played.policy, "episodes": len(rows)}
    for name in ("goals", "reward", "spl", "replans"):
        found = bootstrap([row[name] for row in rows])
        row |= {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}
    times = [time for time in WITHIN if time <= trace.decisions] or [trace.decisions]
    first = first_goal(trace)
    for time, share in zip(times, success_within(first, times), strict=True):
        found = bootstrap((first >= 0) & (first <= time))
        row |= {
            f"success_{time}": float(share),
            f"success_{time}_low": found.low,
            f"success_{time}_high": found.high,
        }
    row["detour"] = mean_detour(played.measures)
    row |= _fault_numbers(played, explored, slow=config.evaluate.slow)
    return row


def _fault_numbers(played: Played, explored: Explored, *, slow: int) -> Row:
    trace, ways = played.trace, explored.ways
    waypoints = np.asarray(explored.poses[:, :2], np.float64)
    cuts = judge_cuts(trace, ways, waypoints)
    delays = detection_delays(trace, ways, cuts)
    numbers: Row = {
        f"cuts_{verdict}": sum(cut.verdict == verdict for cut in cuts)
        for verdict in ("blockage", "false_edge", "false_block")
    }
    numbers["detection_delay"] = float(np.median(delays)) if len(delays) else math.nan
    has_map = bool((trace.place >= 0).any())
    faults = classify_decisions(trace, ways, waypoints)
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
        |  | oracle |
        | --- | --- |
        | goals | 133 (130 to 136.2) |
        | detour | 1.25 |
    """
    names = [
        name
        for name in rows[0]
        if name != "policy" and not name.endswith(("_low", "_high"))
    ]
    policies = " | ".join(str(row["policy"]) for row in rows)
    lines = [f"|  | {policies} |", "| --- " * (len(rows) + 1) + "|"]
    for name in names:
        values = " | ".join(_cell(row, name) for row in rows)
        lines.append(f"| {name} | {values} |")
    return "\n".join([title, "", *lines])


def _cell(row: Row, name: str) -> str:
    def short(value: float) -> str:
        return "" if math.isnan(value) else f"{value:.4g}"

    low, high = (float(row.get(f"{name}_{end}", math.nan)) for end in ("low", "high"))
    middle = short(float(row[name]))
    if math.isnan(low) or low == high:
        return middle
    return f"{middle} ({short(low)} to {short(high)})"
