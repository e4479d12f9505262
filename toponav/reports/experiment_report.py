"""The table of an experiment, from the folders of its runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rliable.metrics import aggregate_iqm

from toponav.config import ExperimentConfig, require
from toponav.metrics import (
    Estimate,
    Floats,
    bootstrap,
    decisions_to_reach,
    running_mean,
    top_mean,
)
from toponav.reports.navigation_report import WITHIN
from toponav.reports.sweep_report import WINDOW
from toponav.runs import Exploration, read_exploration, read_pretraining

#: The policy of each run that is judged: that of its end. A best one is not kept by
#: every reward method, and choosing would favour those that keep one.
JUDGED = "last"
#: What the paper's columns are called.
PAPER = "paper: "
_LEVELS = (50, 90, 100)
_SAVED = 90
#: Names of all columns of a table of explorations, and of one of pre-trainings.
EXPLORE_COLUMNS = (
    *("coverage (%)", "IQM (%)", "top 5 (%)", "top 5 runs (%)", "best episode (%)"),
    *(f"decisions to {level} %" for level in _LEVELS),
    *(f"training to {level} %" for level in _LEVELS),
    *("difference (%)", "saved to 90 %", "pre-training"),
)
PRETRAIN_COLUMNS = (
    *("TC accuracy (%)", "TC IQM (%)", "L accuracy (%)", "L IQM (%)"),
    *("waypoints (%)", "difference (%)"),
)
NAVIGATE_COLUMNS = (
    *("goals", "goals (IQM)", "reward", "of the oracle (%)"),
    *(f"success {time} (%)" for time in WITHIN),
    "difference (goals)",
)
_COLUMNS = {
    "explore": EXPLORE_COLUMNS,
    "pretrain": PRETRAIN_COLUMNS,
    "navigate": NAVIGATE_COLUMNS,
}


@dataclass(frozen=True)
class Group:
    """The runs of a row in a maze, by seed."""

    row: str
    maze: str
    runs: Mapping[int, Path]
    wanted: int  # how many there should be
    #: Decisions that its networks learned from before; NaN if unknown.
    before: float = 0.0
    against: str | None = None
    #: The paper's own figures, by column.
    paper: Mapping[str, float] = field(default_factory=dict)


def require_columns(experiment: ExperimentConfig) -> None:
    """Refuse columns that the experiment's table cannot have.

    Raises:
        SettingsError: with the columns that there are.
    """
    known = _COLUMNS[experiment.recipe]
    figures = [name for one in experiment.paper for name in one.values]
    for name in (*experiment.columns, *figures):
        rule = f"experiment.columns must be some of {', '.join(known)}"
        require(name in known, rule, f"'{name}'")


def explore_table(
    groups: Sequence[Group],
    scripted: Mapping[str, Sequence[Mapping[str, Any]]],
    *,
    draws: int,
) -> pd.DataFrame:
    """A row for each group, and for each scripted policy of a maze.

    ``scripted`` has, by maze, rows as ``evaluation.csv`` has them.
    """
    read = {
        (one.row, one.maze): {
            seed: read_exploration(at) for seed, at in one.runs.items()
        }
        for one in groups
    }
    covered = {
        key: {seed: _judged(one)["score"].to_numpy() for seed, one in found.items()}
        for key, found in read.items()
    }
    before = {(one.row, one.maze): one.before for one in groups}
    rows = []
    for maze in dict.fromkeys(one.maze for one in groups):
        for group in groups:
            if group.maze != maze:
                continue
            found = list(read[group.row, maze].values())
            entry = group_head(group)
            if found:
                values = covered[group.row, maze]
                entry |= _coverage(pd.concat(map(_judged, found)), draws)
                entry |= _estimates(stack_runs(values), draws)
                entry |= _training(found, group.before)
                other = covered.get((group.against or "", maze), {})
                entry |= _difference(values, other, draws)
                key = (group.against or "", maze)
                more = before.get(key, 0.0) - group.before
                entry |= _saved(read[group.row, maze], read.get(key, {}), more, draws)
            rows.append(entry | paper_figures_of(group))
        tables = pd.DataFrame(scripted.get(maze, ()))
        for policy, table in (
            tables.groupby("policy", sort=False) if len(tables) else ()
        ):
            percent = table.assign(score=100 * table["coverage"])
            entry = {"maze": maze, "row": str(policy), "runs": "-"}
            entry |= _coverage(percent, draws)
            rows.append(entry | _estimates(percent["score"].to_numpy(), draws))
    return ordered_table(rows, EXPLORE_COLUMNS)


def group_head(group: Group) -> dict[str, Any]:
    """Maze and label of a row, and how many of its runs there are."""
    count = f"{len(group.runs)} of {group.wanted}"
    return {"maze": group.maze, "row": group.row, "runs": count}


def paper_figures_of(group: Group) -> dict[str, float]:
    """The paper's figures for a row, by what its columns are called here."""
    return {f"{PAPER}{name}": value for name, value in group.paper.items()}


def _judged(one: Exploration) -> pd.DataFrame:
    return one.evaluation[one.evaluation["policy"] == JUDGED]


def judged_score(run: Path) -> float:
    """Mean score of a finished exploration's judged policy; its coverage, in %."""
    return float(_judged(read_exploration(run))["score"].mean())


def stack_runs(values: Mapping[int, Floats]) -> Floats:
    """``[R, E]``, of the episodes that all runs have."""
    least = min(map(len, values.values()))
    return np.stack([one[:least] for one in values.values()])


def _estimates(values: Floats, draws: int) -> dict[str, Any]:
    of_runs = values.mean(1) if values.ndim == 2 else np.empty(0)
    return {
        "coverage (%)": bootstrap(values, draws=draws),
        "IQM (%)": bootstrap(values, aggregate_iqm, draws=draws),
        "top 5 (%)": top_mean(values),
        "top 5 runs (%)": top_mean(of_runs),
        "best episode (%)": float(values.max()),
    }


def _coverage(table: pd.DataFrame, draws: int) -> dict[str, float]:
    """Medians of the decisions of an episode until it has covered so much."""
    names = {level: f"decisions_to_{level}" for level in _LEVELS}
    return {
        f"decisions to {level} %": decisions_to_reach(table[name])[0]
        for level, name in names.items()
        if name in table
    }


def _training(found: Sequence[Exploration], before: float) -> dict[str, float]:
    """Medians of the decisions of the training, ``before`` included, to each level."""
    measured = {"pre-training": before}
    for level in _LEVELS:
        taken = [_reached(one, level) for one in found]
        measured[f"training to {level} %"] = decisions_to_reach(taken)[0] + before
    return measured


def _reached(one: Exploration, level: float) -> float:
    """Decisions until the mean of the last episodes covers so much, -1 if never.

    All of the maze counts as soon as one episode covers it.
    """
    score = one.episodes["score"].to_numpy()
    if level < 100:
        score = running_mean(score, WINDOW)
        score[: WINDOW - 1] = 0.0
    good = np.flatnonzero(score >= level - 1e-6)
    return float(one.episodes["decisions"].iloc[good[0]]) if len(good) else -1.0


def _saved(
    own: Mapping[int, Exploration],
    other: Mapping[int, Exploration],
    more: float,
    draws: int,
) -> dict[str, Estimate]:
    """Fewer decisions of the training to 90 % than the other runs with equal seeds.

    ``more`` is what the others' networks learned from beyond that of one's own. Nothing
    if one of the runs never gets there: how much it saves is not known.
    """
    pairs = [
        (_reached(other[seed], _SAVED), _reached(own[seed], _SAVED))
        for seed in own
        if seed in other
    ]
    if not pairs or min(map(min, pairs)) < 0 or math.isnan(more):
        return {}
    saved = np.array([[theirs - ours + more] for theirs, ours in pairs])
    return {"saved to 90 %": bootstrap(saved, draws=draws)}


def _difference(
    own: Mapping[int, Floats], other: Mapping[int, Floats], draws: int
) -> dict[str, Estimate]:
    """Of runs with one seed, episode by episode, which start in the same places."""
    seeds = [seed for seed in own if seed in other]
    if not seeds:
        return {}
    least = min(len(side[seed]) for side in (own, other) for seed in seeds)
    pairs = np.stack([own[seed][:least] - other[seed][:least] for seed in seeds])
    return {"difference (%)": bootstrap(pairs, draws=draws)}


def pretrain_table(groups: Sequence[Group], *, draws: int) -> pd.DataFrame:
    """A row for each group of pre-trainings, the means over the mazes of each run."""
    read = {
        (one.row, one.maze): {
            seed: 100 * read_pretraining(at).mean(numeric_only=True)
            for seed, at in one.runs.items()
        }
        for one in groups
    }
    rows = []
    for group in groups:
        found = read[group.row, group.maze]
        entry = group_head(group)
        if found:
            other = read.get((group.against or "", group.maze), {})
            entry |= _accuracies(found, other, draws)
        rows.append(entry | paper_figures_of(group))
    return ordered_table(rows, PRETRAIN_COLUMNS)


def _accuracies(
    found: Mapping[int, pd.Series], other: Mapping[int, pd.Series], draws: int
) -> dict[str, Any]:
    def values(name: str, of: Mapping[int, pd.Series] = found) -> dict[int, Floats]:
        return {seed: np.array([one[name]]) for seed, one in of.items()}

    entry: dict[str, Any] = {}
    for label, name in (("TC", "accuracy"), ("L", "locomotion_accuracy")):
        every = stack_runs(values(name))
        if np.isfinite(every).all():
            entry[f"{label} accuracy (%)"] = bootstrap(every, draws=draws)
            entry[f"{label} IQM (%)"] = bootstrap(every, aggregate_iqm, draws=draws)
    shares = [
        name for name in next(iter(found.values())).index if "waypoint_sh" in name
    ]
    if shares:
        # At the largest threshold, as the paper keeps them.
        last = max(shares, key=lambda name: float(name.rpartition("_")[2]))
        entry["waypoints (%)"] = bootstrap(stack_runs(values(last)), draws=draws)
    return entry | _difference(values("accuracy"), values("accuracy", other), draws)


def ordered_table(
    rows: Sequence[Mapping[str, Any]], columns: Sequence[str]
) -> pd.DataFrame:
    """Columns that some row has: maze and row, the measured ones, the paper's, runs."""
    there = dict.fromkeys(name for row in rows for name in row)
    paper = [name for name in there if name.startswith(PAPER)]
    measured = [name for name in columns if name in there]
    table = pd.DataFrame(list(rows), dtype=object)
    return table.reindex(columns=["maze", "row", *measured, *paper, "runs"])
