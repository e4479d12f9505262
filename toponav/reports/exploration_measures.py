"""What the runs of a table's row did, by seed: coverage, and beside another row."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from rliable.metrics import aggregate_iqm

from toponav.metrics import AtMost, Estimate, Floats, bootstrap
from toponav.reports.training_curves import decisions_until, median_until
from toponav.runs import Exploration, read_exploration

#: The policy of each run that is judged: that of its end. A best one is not kept by
#: every reward method, and choosing would favour those that keep one.
JUDGED = "last"
#: Shares of a maze in percent, the decisions to which are counted.
LEVELS = (50, 90, 100)
COVERAGE, IQM, DIFFERENCE = "coverage (%)", "IQM (%)", "difference (%)"
#: By the seed of a run, ``[E]``: a number for each of its episodes, or one.
Values = Mapping[int, Floats]


@dataclass(frozen=True)
class Explored:
    """The finished runs of a row in a maze, by seed."""

    runs: Mapping[int, Exploration] = field(default_factory=dict)
    #: Decisions that their networks learned from before; NaN if unknown.
    before: float = 0.0

    def judged(self) -> list[pd.DataFrame]:
        """The episodes of each run's judged policy."""
        return [judged_episodes(one) for one in self.runs.values()]

    def coverage(self) -> Values:
        """Of the episodes of each run's judged policy, in percent."""
        every = zip(self.runs, self.judged(), strict=True)
        return {seed: one["score"].to_numpy(np.float64) for seed, one in every}


def judged_episodes(one: Exploration) -> pd.DataFrame:
    """Rows of ``evaluation.csv`` of the policy that a table judges a run by."""
    return one.evaluation[one.evaluation["policy"] == JUDGED]


def judged_score(run: Path) -> float:
    """Mean score of a finished exploration's judged policy; its coverage, in %."""
    return float(judged_episodes(read_exploration(run))["score"].mean())


def kept_return(run: Path) -> float:
    """Mean return of the policy that a finished exploration kept: the better one."""
    table = read_exploration(run).evaluation
    learned = table[table["policy"].isin(["best", JUDGED])]
    return float(learned.groupby("policy")["intrinsic_return"].mean().max())


def measures(own: Explored, other: Explored) -> dict[str, Values]:
    """What a row's columns with intervals are made of, by column.

    ``other`` is the row that it is compared with, without runs if there is none:
    differences are of runs with equal seeds, episode by episode, since these start in
    the same places.
    """
    covered = own.coverage()
    found: dict[str, Values] = {COVERAGE: covered, IQM: covered}
    found[DIFFERENCE] = differences(covered, other.coverage())
    for level in LEVELS:
        found[f"saved to {level} %"] = _saved(own, other, level)
    return {name: values for name, values in found.items() if values}


def differences(own: Values, other: Values) -> Values:
    """Own less the other's of the seeds that both have, episode by episode."""
    seeds = [seed for seed in own if seed in other]
    least = min((len(side[s]) for side in (own, other) for s in seeds), default=0)
    return {seed: own[seed][:least] - other[seed][:least] for seed in seeds}


def _saved(own: Explored, other: Explored, level: int) -> Values:
    """Fewer decisions of the training to a level than runs with equal seeds, ``[1]``.

    Those that the networks learned from before are counted. Nothing if one of the runs
    never gets there, or is there from the start: how much it saves is not known.
    """
    more = other.before - own.before
    ours, theirs = (
        {seed: _known(decisions_until(one, level)) for seed, one in side.runs.items()}
        for side in (own, other)
    )
    saved = {seed: theirs[seed] - ours[seed] + more for seed in ours if seed in theirs}
    known = all(map(math.isfinite, saved.values()))
    return {seed: np.array([one]) for seed, one in saved.items()} if known else {}


def _known(decisions: float | AtMost) -> float:
    return decisions if isinstance(decisions, float) and decisions >= 0 else math.nan


def stack_runs(values: Values) -> Floats:
    """``[R, E]``, of the episodes that all runs have."""
    least = min(map(len, values.values()))
    return np.stack([one[:least] for one in values.values()])


def stack_mazes(mazes: Sequence[Values]) -> Floats:
    """``[M, R, E]``, of the seeds that have a run in every maze; empty without any."""
    seeds = [seed for seed in mazes[0] if all(seed in one for one in mazes)]
    if not seeds:
        return np.empty((len(mazes), 0, 0))
    least = min(len(one[seed]) for one in mazes for seed in seeds)
    return np.stack([[one[seed][:least] for seed in seeds] for one in mazes])


def estimate(column: str, values: Floats, draws: int) -> Estimate:
    """The mean of a column's values, or their interquartile mean, with its interval."""
    if column == IQM:
        return bootstrap(values, aggregate_iqm, draws=draws)
    return bootstrap(values, draws=draws)


def training_columns(own: Explored) -> dict[str, float | AtMost]:
    """Medians of the decisions of the training, ``before`` included, to each level."""
    measured: dict[str, float | AtMost] = {"pre-training": own.before}
    for level in LEVELS:
        found = median_until(own.runs.values(), level, before=own.before)
        measured[f"training to {level} %"] = found
    return measured
