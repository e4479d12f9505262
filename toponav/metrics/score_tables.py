"""Tables of estimates, as Markdown and as CSV."""

import math

import pandas as pd

from toponav.metrics.statistics import AtMost, Estimate

#: What Markdown calls these columns.
_HEADS = {"mean": "mean (95 %)", "iqm": "IQM (95 %)"}
_HEADS |= {"top_5": "top 5", "top_5_draws": "top 5 draws"}
# Stands below a table with such rows.
_OF_ONE_RUN = (
    "where a row is of one run, or over several mazes of one seed, its intervals are "
    "over episodes alone and say nothing about other seeds"
)
# What CSV has of such a cell in columns by themselves, by the ends of their names.
_ENDS = {Estimate: {"low": "low", "high": "high"}, AtMost: {"at most": "value"}}


def markdown_table(table: pd.DataFrame) -> str:
    """The table of `summarize_scores` in Markdown, its columns aligned.

    Below it stands what its readers must know of its intervals.
    """
    texts = {
        _HEADS.get(name, name): [_text(name, value) for value in table[name]]
        for name in table
    }
    if not len(table):
        return ""
    return aligned_table(pd.DataFrame(texts)) + intervals_note(table)


def _text(name: str, value: object) -> str:
    if isinstance(value, float):
        places = 1 if name.endswith("(%)") or name[:5] == "top_5" else 0
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


def intervals_note(table: pd.DataFrame) -> str:
    """What stands below a table with intervals over one run's episodes; else empty."""
    cells = (one for name in table for one in table[name])
    some = any(isinstance(one, Estimate) and one.of_one_run for one in cells)
    return f"\n- {_OF_ONE_RUN}\n" if some else ""


def csv_table(table: pd.DataFrame, *, sep: str = "_") -> str:
    """The same as CSV; ends of intervals, and bounds, are in columns by themselves.

    ``sep`` stands between the name of a column and the end that is added to it.
    """
    columns: dict[str, list[object]] = {}
    for name in table:
        column = list(table[name])
        columns[name] = list(map(_number, column))
        for kind, ends in _ENDS.items():
            if any(isinstance(one, kind) for one in column):
                for end, of in ends.items():
                    columns[f"{name}{sep}{end}"] = [
                        getattr(one, of) if isinstance(one, kind) else math.nan
                        for one in column
                    ]
    frame = pd.DataFrame(columns)
    text: str = frame.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    return text


def _number(value: object) -> object:
    """What a column has of a cell; a bound is no measurement."""
    if isinstance(value, AtMost):
        return math.nan
    return value.value if isinstance(value, Estimate) else value
