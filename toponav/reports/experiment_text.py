"""The table of an experiment as Markdown and as CSV."""

import math
from collections.abc import Sequence

import pandas as pd

from toponav.metrics import (
    AtMost,
    Estimate,
    aligned_table,
    csv_table,
    intervals_note,
)
from toponav.reports.experiment_report import PAPER


def experiment_markdown(table: pd.DataFrame, columns: Sequence[str]) -> str:
    """The table with these columns, and the paper's figures for some of them."""
    paper = [f"{PAPER}{name}" for name in columns if f"{PAPER}{name}" in table]
    shown = [name for name in columns if name in table]
    texts = table[["maze", "row", *shown, *paper, "runs"]].map(_text)
    return aligned_table(texts) + intervals_note(table[shown])


def _text(value: object) -> str:
    if isinstance(value, str | Estimate | AtMost):
        return str(value)
    if value is None or math.isnan(number := float(value)):  # type: ignore[arg-type]
        return "-"
    if math.isinf(number):
        return "never"
    return f"{number:,.0f}" if number > 100 else f"{number:.1f}"


def experiment_csv(table: pd.DataFrame) -> str:
    """The whole table as CSV; ends of intervals, and bounds, are by themselves."""
    return csv_table(table, sep=" ")
