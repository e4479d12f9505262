"""The table of a sweep: what its groups of runs reached, and how sure that is."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from rliable.metrics import aggregate_iqm

from toponav.metrics.statistics import Floats, bootstrap, top_mean

#: What Markdown calls these columns.
_HEADS = {"mean": "mean (95 %)", "iqm": "IQM (95 %)", "top_5": "top 5"}


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


def summarize_scores(
    groups: Sequence[Scores], *, subject: str, unit: str = "values", draws: int = 2000
) -> pd.DataFrame:
    """The table of a sweep, a row for each group.

    ``mean`` and ``iqm``, the interquartile mean, are `Estimate` with 95 % intervals of
    ``draws`` bootstrap samples; ``top_5`` is the mean of the five largest values, NaN
    if there are fewer. ``subject`` and ``unit`` name the columns of the subjects and of
    the counts.

    Examples:
        >>> values = np.array([[80.0, 90.0], [70.0, 80.0]])
        >>> scores = Scores({"seed": "0"}, "best", "coverage (%)", values)
        >>> table = summarize_scores([scores], subject="policy")
        >>> print(table["mean"][0], table["runs"][0])
        80.0 (72.5 to 87.5) 2
    """
    settings = dict.fromkeys(name for one in groups for name in one.settings)
    more = dict.fromkeys(name for one in groups for name in one.more)
    return pd.DataFrame(
        {
            **{name: one.settings.get(name, "") for name in settings},
            subject: one.subject,
            "measure": one.measure,
            "mean": bootstrap(one.values, draws=draws),
            "iqm": bootstrap(one.values, aggregate_iqm, draws=draws),
            "top_5": top_mean(one.values),
            **{name: one.more.get(name, math.nan) for name in more},
            "runs": len(one.values) if one.values.ndim == 2 else None,
            unit: one.values.size,
        }
        for one in groups
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


def markdown_table(table: pd.DataFrame) -> str:
    """The table of `summarize_scores` in Markdown, its columns aligned."""
    texts = {
        _HEADS.get(name, name): [_text(name, value) for value in table[name]]
        for name in table
    }
    return aligned_table(pd.DataFrame(texts)) if len(table) else ""


def _text(name: str, value: object) -> str:
    if isinstance(value, float):
        places = 1 if name.endswith("(%)") or name == "top_5" else 0
        return "-" if math.isnan(value) else f"{value:,.{places}f}"
    return "-" if value is None else str(value)


def aligned_table(frame: pd.DataFrame) -> str:
    """Texts as a Markdown table with aligned columns, ending in a line break."""
    columns = [
        pd.Series([name, *frame[name]]).str.replace("|", "\\|", regex=False)
        for name in frame
    ]
    padded = [column.str.ljust(column.str.len().max()) for column in columns]
    head, *rows = ["| " + " | ".join(row) + " |" for row in zip(*padded, strict=True)]
    rule = "|" + "|".join("-" * (len(column[0]) + 2) for column in padded) + "|"
    return "\n".join([head, rule, *rows]) + "\n"


def csv_table(table: pd.DataFrame) -> str:
    """The same as CSV, the ends of the intervals by themselves."""
    columns = {}
    for name in table:
        columns[name] = table[name]
        if name in ("mean", "iqm"):
            columns[name] = [one.value for one in table[name]]
            columns[f"{name}_low"] = [one.low for one in table[name]]
            columns[f"{name}_high"] = [one.high for one in table[name]]
    frame = pd.DataFrame(columns)
    text: str = frame.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    return text
