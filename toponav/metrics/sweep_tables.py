"""The table of a sweep: what its groups of runs reached, and how sure that is."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from rliable.metrics import aggregate_iqm

from toponav.metrics.statistics import Estimate, Floats, bootstrap, top_mean


@dataclass(frozen=True)
class Scores:
    """One measure of a group of runs that differ in their seeds alone.

    Values are ``[R, E]`` of R runs with E episodes each, ``[R, 1]`` for one value a
    run, or ``[N]`` for episodes that are of no run.
    """

    settings: Mapping[str, str]  # what sets the group apart from the others, by name
    subject: str  # what was measured, such as a policy or a maze
    measure: str  # the name of the values, with their unit
    values: Floats
    #: Other numbers; a name that ends in ``(%)`` gets one decimal place, others none.
    more: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Summary:
    """Mean, interquartile mean and mean of the top five (NaN if fewer) of scores."""

    scores: Scores
    mean: Estimate
    iqm: Estimate
    top: float

    @property
    def num_runs(self) -> int:
        return len(self.scores.values) if self.scores.values.ndim == 2 else 0

    @property
    def num_values(self) -> int:
        return self.scores.values.size


def summarize_scores(scores: Scores, *, draws: int = 2000, seed: int = 0) -> Summary:
    """Mean, interquartile mean and top five, the first two with 95 % intervals.

    The intervals come from ``draws`` bootstrap samples.

    Examples:
        >>> values = np.array([[80.0, 90.0], [70.0, 80.0]])
        >>> found = summarize_scores(Scores({}, "best", "coverage (%)", values))
        >>> round(found.mean.value, 3), found.num_runs, found.num_values
        (80.0, 2, 4)
    """
    return Summary(
        scores,
        mean=bootstrap(scores.values, draws=draws, seed=seed),
        iqm=bootstrap(scores.values, aggregate_iqm, draws=draws, seed=seed),
        top=top_mean(scores.values),
    )


def decisions_to_reach(decisions: ArrayLike) -> tuple[float, float]:
    """Median of the decisions to a level, and the share of episodes that got there.

    Episodes that did not get there, -1, count as longer than any other: leaving them
    out would reward a policy that seldom arrives. The median is NaN unless more than
    half of the episodes got there.

    Examples:
        >>> decisions_to_reach([400, -1, 900])
        (900.0, 0.6666666666666666)
    """
    taken = np.ravel(np.asarray(decisions, np.float64))
    if not len(taken):
        raise ValueError("decisions must be of at least one episode, got none")
    reached = taken >= 0
    median = float(np.median(np.where(reached, taken, np.inf)))
    return median if math.isfinite(median) else math.nan, float(reached.mean())


def markdown_table(
    summaries: Sequence[Summary], *, subject: str, unit: str = "values"
) -> str:
    """The summaries as a Markdown table, a row each, its columns aligned.

    ``subject`` and ``unit`` head the columns of the subjects and of the counts.
    """
    if not summaries:
        return ""
    named, others = _names(summaries)
    frame = pd.DataFrame(
        {
            **{name: one.scores.settings.get(name, "") for name in named},
            subject: one.scores.subject,
            "measure": one.scores.measure,
            "mean (95 %)": str(one.mean),
            "IQM (95 %)": str(one.iqm),
            "top 5": _number(one.top, 1),
            **{
                name: _number(one.scores.more.get(name, math.nan), _places(name))
                for name in others
            },
            "runs": str(one.num_runs or "-"),
            unit: str(one.num_values),
        }
        for one in summaries
    )
    return aligned_table(frame)


def aligned_table(frame: pd.DataFrame) -> str:
    """Texts as a Markdown table with aligned columns, ending in a line break."""
    columns = [
        pd.Series([name, *frame[name]]).str.replace("|", "\\|", regex=False)
        for name in frame
    ]
    widths = [int(column.str.len().max()) for column in columns]
    padded = [
        column.str.ljust(width) for column, width in zip(columns, widths, strict=True)
    ]
    head, *rows = ["| " + " | ".join(row) + " |" for row in zip(*padded, strict=True)]
    rule = "|" + "|".join("-" * (width + 2) for width in widths) + "|"
    return "\n".join([head, rule, *rows]) + "\n"


def csv_table(
    summaries: Sequence[Summary], *, subject: str, unit: str = "values"
) -> str:
    """The summaries as CSV: the same rows, the ends of the intervals by themselves."""
    named, others = _names(summaries)
    frame = pd.DataFrame(
        {
            **{name: one.scores.settings.get(name, "") for name in named},
            subject: one.scores.subject,
            "measure": one.scores.measure,
            **_ends("mean", one.mean),
            **_ends("iqm", one.iqm),
            "top_5": one.top,
            **{name: one.scores.more.get(name, math.nan) for name in others},
            "runs": str(one.num_runs or ""),
            unit: one.num_values,
        }
        for one in summaries
    )
    text: str = frame.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    return text


def _names(summaries: Sequence[Summary]) -> tuple[list[str], list[str]]:
    settings = dict.fromkeys(name for one in summaries for name in one.scores.settings)
    more = dict.fromkeys(name for one in summaries for name in one.scores.more)
    return list(settings), list(more)


def _places(name: str) -> int:
    return 1 if name.endswith("(%)") else 0


def _number(value: float, places: int) -> str:
    return "-" if math.isnan(value) else f"{value:,.{places}f}"


def _ends(name: str, one: Estimate) -> dict[str, float]:
    return {name: one.value, f"{name}_low": one.low, f"{name}_high": one.high}
