"""The rows of an experiment over all its mazes, and which of them is best."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from toponav.config import RowConfig
from toponav.metrics import Estimate
from toponav.reports.exploration_measures import (
    COVERAGE,
    DIFFERENCE,
    Values,
    estimate,
    stack_mazes,
)

#: What stands for the maze in rows over all mazes.
ALL_MAZES = "all mazes"


def pooled_row(
    row: str, mazes: Sequence[Mapping[str, Values]], *, wanted: int, draws: int
) -> dict[str, Any]:
    """A row over several mazes, each of which counts alike, from what each has.

    Seeds are drawn for all mazes together, and differences are of equal mazes and
    seeds. A seed that lacks a run in one of the mazes is left out of all.

    Args:
        row: its label.
        mazes: `measures` of the row in each maze.
        wanted: runs that there should be.
        draws: bootstrap samples behind each interval.
    """
    entry: dict[str, Any] = {"maze": ALL_MAZES, "row": row}
    count = 0
    for column in mazes[0]:
        if all(column in one for one in mazes):
            values = stack_mazes([one[column] for one in mazes])
            if values.size:
                entry[column] = estimate(column, values, draws)
            if column == COVERAGE:
                count = values.shape[0] * values.shape[1]
    return entry | {"runs": f"{count} of {wanted}"}


def best_sentences(rows: Sequence[RowConfig], table: pd.DataFrame) -> list[str]:
    """Which row covers most over all mazes, and by how much; nothing if rows differ.

    That is asked where all rows but one are compared with that one.
    """
    against = {row.against for row in rows if row.against}
    pooled = table[table["maze"] == ALL_MAZES].set_index("row")
    others = [row.label for row in rows if row.label not in against]
    if len(against) != 1 or not all(row.against for row in rows if row.label in others):
        return []
    (base,) = against
    known = {
        row: found
        for row in others
        if row in pooled.index and DIFFERENCE in pooled
        if isinstance(found := pooled[DIFFERENCE][row], Estimate)
    }
    if not known:
        return []
    best = max(known, key=lambda row: known[row].value)
    found = known[best]
    more = "more" if found.value > 0 else "less"
    text = f"over {ALL_MAZES} '{best}' covers most of the rows beside '{base}': "
    text += f"{abs(found.value):.1f} points {more} than it{_certainty(found)}"
    return [text]


def _certainty(found: Estimate) -> str:
    if found.of_one_run:
        return " (of one seed, which says nothing about others)"
    if math.isnan(found.low):
        return ""
    ends = f"difference {found.low:+.1f} to {found.high:+.1f}"
    apart = found.low > 0 or found.high < 0
    return f" ({ends}, which {'leaves out' if apart else 'includes'} 0)"
