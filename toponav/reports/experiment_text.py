"""The table of an experiment as Markdown and as CSV."""

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd

from toponav.metrics import Estimate, aligned_table
from toponav.reports.experiment_report import PAPER


def experiment_markdown(table: pd.DataFrame, columns: Sequence[str]) -> str:
    """The table with these columns, and the paper's figures for some of them."""
    paper = [f"{PAPER}{name}" for name in columns if f"{PAPER}{name}" in table]
    shown = [name for name in columns if name in table]
    texts = table[["maze", "row", *shown, *paper, "runs"]].map(_text)
    return aligned_table(texts)


def _text(value: object) -> str:
    if isinstance(value, str | Estimate):
        return str(value)
    if value is None or math.isnan(number := float(value)):  # type: ignore[arg-type]
        return "-"
    if math.isinf(number):
        return "never"
    return f"{number:,.0f}" if number > 100 else f"{number:.1f}"


def experiment_csv(table: pd.DataFrame) -> str:
    """The whole table as CSV, the ends of the intervals by themselves."""
    columns: dict[str, Any] = {}
    for name in table:
        column = list(table[name])
        if any(isinstance(one, Estimate) for one in column):
            for end, of in (("", "value"), (" low", "low"), (" high", "high")):
                columns[f"{name}{end}"] = [getattr(one, of, math.nan) for one in column]
        else:
            columns[name] = column
    frame = pd.DataFrame(columns)
    text: str = frame.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    return text
