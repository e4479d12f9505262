"""The table of a sweep: what its groups of runs reached, with how much chance in it.

- `Scores`: one measure of one group of runs.
- `Summary`: its mean, interquartile mean and top five, made by `summarize_scores`.
- `markdown_table`, `csv_table`: the summaries as text.
"""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from toponav.evaluation.statistics import (
    Estimate,
    bootstrap,
    interquartile_mean,
    mean,
    top_mean,
)

_TOP = 5


@dataclass(frozen=True)
class Scores:
    """One measure of a group of runs that differ in their seeds alone.

    Args:
        settings: what tells the group from the others, by name.
        subject: what was measured, such as a policy or a maze.
        measure: the name of the values, with their unit.
        values: ``[R, E]`` of R runs with E episodes each, ``[R, 1]`` for one value a
            run; ``[N]`` for episodes that are of no run.
        more: other numbers of the group; a name that ends in ``(%)`` has one decimal
            place in the table, any other name none.
    """

    settings: Mapping[str, str]
    subject: str
    measure: str
    values: NDArray[np.float64]
    more: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Summary:
    """What `summarize_scores` makes of `Scores`.

    Args:
        scores: what it was made of.
        mean: mean of all values.
        iqm: mean of their middle half.
        top: mean of the five largest, NaN if there are fewer.
    """

    scores: Scores
    mean: Estimate
    iqm: Estimate
    top: float

    @property
    def num_runs(self) -> int:
        """How many runs are in it; 0 if its episodes are of no run."""
        return len(self.scores.values) if self.scores.values.ndim == 2 else 0

    @property
    def num_values(self) -> int:
        """How many values are in it: episodes, or runs if each gave one value."""
        return self.scores.values.size


def summarize_scores(scores: Scores, *, seed: int = 0) -> Summary:
    """Mean, interquartile mean and top five, the first two with 95 % intervals.

    Args:
        scores: the values of a group.
        seed: of the bootstrap.

    Raises:
        ValueError: as `bootstrap`.

    Examples:
        >>> values = np.array([[80.0, 90.0], [70.0, 80.0]])
        >>> found = summarize_scores(Scores({}, "best", "coverage (%)", values))
        >>> round(found.mean.value, 3), found.num_runs, found.num_values
        (80.0, 2, 4)
    """
    values = np.asarray(scores.values)
    return Summary(
        scores,
        mean=bootstrap(values, mean, seed=seed),
        iqm=bootstrap(values, interquartile_mean, seed=seed),
        top=top_mean(values, _TOP) if values.size >= _TOP else math.nan,
    )


def decisions_to_reach(decisions: ArrayLike) -> tuple[float, float]:
    """Median of the decisions to a level, and the share of episodes that got there.

    Episodes that did not get there count as longer than any other; leaving them out
    would reward a policy that seldom arrives.

    Args:
        decisions: of each episode, -1 where the level was not reached.

    Returns:
        The median, NaN unless more than half of the episodes got there, and the share.

    Raises:
        ValueError: if there is no episode.

    Examples:
        >>> decisions_to_reach([400, -1, 900])
        (900.0, 0.6666666666666666)
        >>> decisions_to_reach([400, -1, -1])
        (nan, 0.3333333333333333)
    """
    taken = np.asarray(decisions, np.float64).reshape(-1)
    if not len(taken):
        raise ValueError("decisions must be of at least one episode, got none")
    reached = taken >= 0
    ordered = np.sort(np.where(reached, taken, np.inf))
    # The two middle ones; not their mean, where one of them is infinite.
    low, high = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]
    median = (low + high) / 2
    return float(median) if np.isfinite(median) else math.nan, float(reached.mean())


def markdown_table(
    summaries: Sequence[Summary], *, subject: str, unit: str = "values"
) -> str:
    """The summaries as a Markdown table, a row each, its columns aligned.

    Args:
        summaries: in the order of the rows.
        subject: heading of the column of the subjects.
        unit: heading of the column that counts the values.

    Returns:
        The table, ending in a line break; empty without summaries.
    """
    if not summaries:
        return ""
    named = _names([one.scores.settings for one in summaries])
    others = _names([one.scores.more for one in summaries])
    head = [
        *named,
        *[subject, "measure", "mean (95 %)", "IQM (95 %)", f"top {_TOP}"],
        *[*others, "runs", unit],
    ]
    rows = [head]
    for one in summaries:
        scores = one.scores
        rows.append(
            [
                *(scores.settings.get(name, "") for name in named),
                *[scores.subject, scores.measure],
                *[_interval(one.mean), _interval(one.iqm), _number(one.top, 1)],
                *(_number(scores.more.get(name), _places(name)) for name in others),
                *[str(one.num_runs or "-"), str(one.num_values)],
            ]
        )
    wide = [max(len(row[column]) for row in rows) for column in range(len(head))]
    lines = [_line(row, wide) for row in rows]
    rule = "|" + "|".join("-" * (width + 2) for width in wide) + "|"
    return "\n".join([lines[0], rule, *lines[1:]]) + "\n"


def csv_table(
    summaries: Sequence[Summary], *, subject: str, unit: str = "values"
) -> str:
    """The summaries as CSV: the same rows, the ends of the intervals by themselves."""
    named = _names([one.scores.settings for one in summaries])
    others = _names([one.scores.more for one in summaries])
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    ends = ["mean", "mean_low", "mean_high", "iqm", "iqm_low", "iqm_high"]
    table.writerow(
        [*named, subject, "measure", *ends, f"top_{_TOP}", *others, "runs", unit]
    )
    for one in summaries:
        mean_, iqm, scores = one.mean, one.iqm, one.scores
        numbers = [mean_.value, mean_.low, mean_.high, iqm.value, iqm.low, iqm.high]
        rest = [scores.more.get(name, math.nan) for name in others]
        table.writerow(
            [
                *(scores.settings.get(name, "") for name in named),
                *[scores.subject, scores.measure],
                *(_plain(number) for number in [*numbers, one.top, *rest]),
                *[one.num_runs or "", one.num_values],
            ]
        )
    return text.getvalue()


def _names(mappings: Sequence[Mapping[str, object]]) -> list[str]:
    """All names, in the order in which they come first."""
    return list(dict.fromkeys(name for one in mappings for name in one))


def _places(name: str) -> int:
    return 1 if name.endswith("(%)") else 0


def _interval(one: Estimate) -> str:
    if math.isnan(one.low):
        return f"{one.value:.1f}"
    return f"{one.value:.1f} ({one.low:.1f} to {one.high:.1f})"


def _number(value: float | None, places: int) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:,.{places}f}"


def _plain(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.6g}"


def _line(row: Sequence[str], wide: Sequence[int]) -> str:
    cells = (
        text.replace("|", "\\|").ljust(width)
        for text, width in zip(row, wide, strict=True)
    )
    return "| " + " | ".join(cells) + " |"
