"""The table of an experiment, from the folders of its runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rliable.metrics import aggregate_iqm

from toponav.config import ExperimentConfig, require
from toponav.metrics import Floats, bootstrap, decisions_to_reach, top_mean
from toponav.reports.exploration_measures import (
    COVERAGE,
    DIFFERENCE,
    IQM,
    LEVELS,
    Explored,
    Values,
    differences,
    estimate,
    measures,
    stack_runs,
    training_columns,
)
from toponav.reports.navigation_report import WITHIN
from toponav.reports.pooled_rows import pooled_row
from toponav.runs import read_exploration, read_pretraining

#: What the paper's columns are called.
PAPER = "paper: "
#: Names of all columns of a table of explorations, and of one of pre-trainings.
EXPLORE_COLUMNS = (
    *(COVERAGE, IQM, "top 5 (%)", "top 5 runs (%)", "best episode (%)", "reward"),
    *(f"decisions to {level} %" for level in LEVELS),
    *(f"training to {level} %" for level in LEVELS),
    *(DIFFERENCE, *(f"saved to {level} %" for level in LEVELS), "pre-training"),
)
PRETRAIN_COLUMNS = (
    *("TC accuracy (%)", "TC IQM (%)", "L accuracy (%)", "L IQM (%)"),
    *("waypoints (%)", DIFFERENCE),
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
    cells: int | None = None  # that the maze has


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
    """A row for each group and scripted policy of a maze, then each over all mazes.

    ``scripted`` has, by maze, rows as ``evaluation.csv`` has them.
    """
    explored = {
        (one.row, one.maze): Explored(
            {seed: read_exploration(at) for seed, at in one.runs.items()}, one.before
        )
        for one in groups
    }
    measured = {
        (one.row, one.maze): measures(
            explored[one.row, one.maze],
            explored.get((one.against or "", one.maze), Explored()),
        )
        for one in groups
    }
    rows = []
    for maze in dict.fromkeys(one.maze for one in groups):
        own = [one for one in groups if one.maze == maze]
        for group in own:
            entry, key = group_head(group), (group.row, maze)
            if group.runs:
                entry |= _columns(explored[key], measured[key], group.cells, draws)
            rows.append(entry | paper_figures_of(group))
        rows += _scripted_rows(maze, scripted.get(maze, ()), own[0].cells, draws)
    return ordered_table([*rows, *_pooled(groups, measured, draws)], EXPLORE_COLUMNS)


def _columns(
    own: Explored, measured: Mapping[str, Values], cells: int | None, draws: int
) -> dict[str, Any]:
    """All columns of a row with runs."""
    stacked = {name: stack_runs(values) for name, values in measured.items()}
    entry: dict[str, Any] = _coverage(pd.concat(own.judged()))
    entry |= {name: estimate(name, found, draws) for name, found in stacked.items()}
    entry |= _best(stacked[COVERAGE]) | _reward(stacked[COVERAGE], cells, draws)
    return entry | training_columns(own)


def _scripted_rows(
    maze: str, rows: Sequence[Mapping[str, Any]], cells: int | None, draws: int
) -> list[dict[str, Any]]:
    """A row for each scripted policy of a maze."""
    found, table = [], pd.DataFrame(rows)
    for policy, own in table.groupby("policy", sort=False) if len(table) else ():
        values = 100 * own["coverage"].to_numpy(np.float64)
        entry: dict[str, Any] = {"maze": maze, "row": str(policy), "runs": "-"}
        entry |= _coverage(own)
        entry |= {name: estimate(name, values, draws) for name in (COVERAGE, IQM)}
        found.append(entry | _best(values) | _reward(values, cells, draws))
    return found


def _pooled(
    groups: Sequence[Group],
    measured: Mapping[tuple[str, str], Mapping[str, Values]],
    draws: int,
) -> list[dict[str, Any]]:
    """A row for each row that has several mazes, over all of them."""
    rows = []
    for row in dict.fromkeys(one.row for one in groups):
        own = [one for one in groups if one.row == row]
        if len(own) > 1:
            each = [measured[row, one.maze] for one in own]
            wanted = sum(one.wanted for one in own)
            rows.append(pooled_row(row, each, wanted=wanted, draws=draws))
    return rows


def group_head(group: Group) -> dict[str, Any]:
    """Maze and label of a row, and how many of its runs there are."""
    count = f"{len(group.runs)} of {group.wanted}"
    return {"maze": group.maze, "row": group.row, "runs": count}


def paper_figures_of(group: Group) -> dict[str, float]:
    """The paper's figures for a row, by what its columns are called here."""
    return {f"{PAPER}{name}": value for name, value in group.paper.items()}


def _best(values: Floats) -> dict[str, float]:
    """The largest of the coverages ``[R, E]`` or ``[E]``, in %."""
    of_runs = values.mean(1) if values.ndim == 2 else np.empty(0)
    return {
        "top 5 (%)": top_mean(values),
        "top 5 runs (%)": top_mean(of_runs),
        "best episode (%)": float(values.max()),
    }


def _reward(values: Floats, cells: int | None, draws: int) -> dict[str, Any]:
    """The reward of coverages in %: 1 for each cell that an episode visits."""
    if cells is None:
        return {}
    return {"reward": bootstrap(values * cells / 100, draws=draws)}


def _coverage(table: pd.DataFrame) -> dict[str, float]:
    """Medians of the decisions of an episode until it has covered so much."""
    names = {level: f"decisions_to_{level}" for level in LEVELS}
    return {
        f"decisions to {level} %": decisions_to_reach(table[name])[0]
        for level, name in names.items()
        if name in table
    }


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
    def values(name: str, of: Mapping[int, pd.Series] = found) -> Values:
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
    if pairs := differences(values("accuracy"), values("accuracy", other)):
        entry[DIFFERENCE] = estimate(DIFFERENCE, stack_runs(pairs), draws)
    return entry


def ordered_table(
    rows: Sequence[Mapping[str, Any]], columns: Sequence[str]
) -> pd.DataFrame:
    """Columns that some row has: maze and row, the measured ones, the paper's, runs."""
    there = dict.fromkeys(name for row in rows for name in row)
    paper = [name for name in there if name.startswith(PAPER)]
    measured = [name for name in columns if name in there]
    table = pd.DataFrame(list(rows), dtype=object)
    return table.reindex(columns=["maze", "row", *measured, *paper, "runs"])
