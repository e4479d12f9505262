"""The table and the figure of an experiment that navigates, from its runs' folders."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from omegaconf import OmegaConf
from rliable.metrics import aggregate_iqm

from toponav.config import read_yaml
from toponav.metrics import Floats, bootstrap, success_within
from toponav.plotting import draw_learning_curves
from toponav.reports.experiment_report import (
    NAVIGATE_COLUMNS,
    Group,
    group_head,
    ordered_table,
    paper_figures_of,
)
from toponav.reports.exploration_measures import stack_runs
from toponav.reports.navigation_report import WITHIN
from toponav.runs import read_navigation

# The policy that a row is about, and the one that is the most there can be.
_CHOSEN, _ORACLE = "navigator", "oracle"
#: Decisions at which the figure begins.
_FIRST = 10


def navigate_table(groups: Sequence[Group], *, draws: int) -> pd.DataFrame:
    """A row for each group, and for each other policy that runs played in its maze."""
    rows = []
    for maze in dict.fromkeys(one.maze for one in groups):
        own = [one for one in groups if one.maze == maze]
        read = {one.row: _played(one, _CHOSEN) for one in own}
        others = _others(own)
        best = _column(others[_ORACLE], "goals").mean() if _ORACLE in others else 0.0
        for group in own:
            entry = group_head(group)
            if found := read[group.row]:
                other = read.get(group.against or "", {})
                entry |= _measures(found, draws, best=best)
                entry |= _difference(found, other, draws)
            rows.append(entry | paper_figures_of(group))
        for policy, tables in others.items():
            entry = {"maze": maze, "row": policy, "runs": "-"}
            rows.append(entry | _measures(tables, draws, best=best))
    return ordered_table(rows, NAVIGATE_COLUMNS)


def navigation_curves(groups: Sequence[Group], *, title: str) -> Figure:
    """Share of the episodes that have reached a goal, over their decisions."""
    panels: dict[str, dict[str, list[tuple[Floats, Floats]]]] = {}
    for maze in dict.fromkeys(one.maze for one in groups):
        own = [one for one in groups if one.maze == maze]
        panel = panels.setdefault(maze, {})
        named = {one.row: _played(one, _CHOSEN) for one in own} | _others(own)
        for name, tables in named.items():
            if tables:
                panel[name] = [_curve(one) for one in tables.values()]
    label = "episodes that have reached a goal (%)"
    x = "decisions of an episode"
    # Who knows the way is there in tens of decisions, who does not in thousands.
    return draw_learning_curves(panels, {}, label=label, title=title, x=x, log_x=True)


def _played(group: Group, policy: str) -> dict[int, pd.DataFrame]:
    """The episodes of a policy in the runs of a group, by seed."""
    tables = {seed: _read(at) for seed, at in group.runs.items()}
    own = {seed: one[one["policy"] == policy] for seed, one in tables.items()}
    return {seed: one for seed, one in own.items() if len(one)}


def _others(groups: Sequence[Group]) -> dict[str, dict[int, pd.DataFrame]]:
    """What other policies played in the runs of a maze, each seed once."""
    found: dict[str, dict[int, pd.DataFrame]] = {}
    for group in groups:
        for seed, folder in group.runs.items():
            for policy, table in _read(folder).groupby("policy", sort=False):
                if policy != _CHOSEN:
                    found.setdefault(str(policy), {}).setdefault(seed, table)
    return found


def _read(folder: Path) -> pd.DataFrame:
    """The episodes of a run, each with the decisions that it had at most."""
    config = read_yaml(folder / "config" / "config.yaml")
    length = OmegaConf.select(config, "maze.episode_length", default=math.inf)
    return read_navigation(folder).assign(length=length)


def _column(tables: Mapping[int, pd.DataFrame], name: str) -> Floats:
    """``[R, E]``, of the episodes that all runs have."""
    values = {seed: one[name].to_numpy(np.float64) for seed, one in tables.items()}
    return stack_runs(values)


def _measures(
    tables: Mapping[int, pd.DataFrame], draws: int, *, best: float
) -> dict[str, Any]:
    goals, first = _column(tables, "goals"), _column(tables, "first_goal")
    found: dict[str, Any] = {
        "goals": bootstrap(goals, draws=draws),
        "goals (IQM)": bootstrap(goals, aggregate_iqm, draws=draws),
        "reward": bootstrap(_column(tables, "reward"), draws=draws),
    }
    if best:
        found["of the oracle (%)"] = float(100 * goals.mean() / best)
    # Within more than an episode has, nobody was asked.
    length = min(one["length"].min() for one in tables.values())
    for time in [one for one in WITHIN if one <= length]:
        reached = 100.0 * ((first >= 0) & (first <= time))
        found[f"success {time} (%)"] = bootstrap(reached, draws=draws)
    return found


def _difference(
    own: Mapping[int, pd.DataFrame], other: Mapping[int, pd.DataFrame], draws: int
) -> dict[str, Any]:
    """Of runs with one seed, episode by episode, which have the same goals."""
    seeds = [seed for seed in own if seed in other]
    if not seeds:
        return {}
    sides = [
        _column({seed: side[seed] for seed in seeds}, "goals") for side in (own, other)
    ]
    least = min(one.shape[1] for one in sides)
    pairs = sides[0][:, :least] - sides[1][:, :least]
    return {"difference (goals)": bootstrap(pairs, draws=draws)}


def _curve(table: pd.DataFrame) -> tuple[Floats, Floats]:
    last = min(max(WITHIN), table["length"].min())
    times = np.geomspace(min(_FIRST, last), last, 201)
    return times, 100 * success_within(table["first_goal"], times)
