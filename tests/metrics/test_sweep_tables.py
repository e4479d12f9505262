import csv
import io
import math
from typing import Any

import numpy as np
import pytest

from toponav.metrics import (
    AtMost,
    Scores,
    csv_table,
    decisions_to_reach,
    markdown_table,
    summarize_scores,
)

RUNS = np.array([[80.0, 90.0, 70.0], [60.0, 70.0, 100.0]])
SCORES = [
    Scores(
        {"maze": "maze3", "reward.alpha": "0.2"},
        "best",
        "coverage (%)",
        RUNS,
        {"decisions to 90 %": 1234.0, "share to 90 % (%)": 66.666},
    ),
    Scores({"maze": "maze3"}, "a|b", "coverage (%)", np.array([[40.0]])),
]
TABLE = summarize_scores(SCORES, subject="policy")
ONE_RUN = (
    "- where a row is of one run, or over several mazes of one seed, its intervals are "
    "over episodes alone and say nothing about other seeds"
)


def row_of(values: np.ndarray) -> Any:
    one = Scores({}, "random", "coverage (%)", values)
    return summarize_scores([one], subject="policy", unit="episodes").loc[0]


def test_a_group_has_mean_iqm_and_top_five() -> None:
    first, second = TABLE.loc[0], TABLE.loc[1]
    assert first["mean"].value == pytest.approx(470 / 6)
    # A quarter of six, rounded down, is one: 70, 70, 80, 90 are left.
    assert first.iqm.value == pytest.approx(77.5)
    assert first.top_5 == pytest.approx((470 - 60) / 5)
    assert (first.runs, first["values"]) == (2, 6)
    assert math.isnan(second.top_5)


def test_episodes_of_no_run_are_counted_alone() -> None:
    one = row_of(np.array([40.0, 50.0])).to_frame().T
    head, _, row = markdown_table(one).splitlines()
    assert cells(head)[-2:] == ["runs", "episodes"]
    assert cells(row)[-2:] == ["-", "2"]
    assert csv_table(one).rstrip().endswith(",,2")


def test_the_interval_counts_runs_as_runs() -> None:
    runs = np.repeat([[20.0], [80.0]], 20, axis=1)
    apart, together = row_of(runs), row_of(runs.reshape(1, -1))
    # One of two runs may be drawn twice; of 40 episodes the mean is sure to 9 or so.
    assert (apart["mean"].low, apart["mean"].high) == (20, 80)
    assert together["mean"].low == pytest.approx(41, abs=2)
    assert (apart.iqm.low, apart.iqm.high) == (20, 80)


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split(" | ")]


def test_markdown_has_a_row_each_and_aligned_columns() -> None:
    head, rule, first, second = markdown_table(TABLE).splitlines()
    assert cells(head) == [
        *["maze", "reward.alpha", "policy", "measure", "mean (95 %)", "IQM (95 %)"],
        *["top 5", "decisions to 90 %", "share to 90 % (%)", "runs", "values"],
    ]
    assert set(rule) == {"|", "-"}
    assert len({len(line) for line in (head, rule, first)}) == 1
    mean = TABLE["mean"][0]
    row = cells(first)
    assert row[:4] == ["maze3", "0.2", "best", "coverage (%)"]
    assert row[4] == f"78.3 ({mean.low:.1f} to {mean.high:.1f})"
    assert row[6:] == ["82.0", "1,234", "66.7", "2", "6"]
    # One value has no interval, and what a row lacks is said to be missing.
    assert cells(second)[1:] == [
        *["", "a\\|b", "coverage (%)", "40.0", "40.0", "-", "-", "-", "1", "1"]
    ]


def test_csv_has_the_numbers_by_themselves() -> None:
    rows = list(csv.DictReader(io.StringIO(csv_table(TABLE))))
    assert [row["policy"] for row in rows] == ["best", "a|b"]
    assert float(rows[0]["mean_low"]) == pytest.approx(TABLE["mean"][0].low, abs=1e-3)
    assert float(rows[0]["top_5"]) == 82
    assert rows[1]["mean_low"] == rows[1]["top_5"] == rows[1]["decisions to 90 %"] == ""


def test_a_bound_is_said_to_be_one_and_is_no_number_of_its_column() -> None:
    more = [{"exploring to 90 %": one} for one in (AtMost(28800.0), 54000.0)]
    scores = [Scores({}, "best", "coverage (%)", RUNS, one) for one in more]
    table = summarize_scores(scores, subject="policy")
    _, _, first, second = markdown_table(table).splitlines()
    assert (cells(first)[5], cells(second)[5]) == ("at most 28,800", "54,000")
    rows = list(csv.DictReader(io.StringIO(csv_table(table))))
    assert [row["exploring to 90 %"] for row in rows] == ["", "54000"]
    assert [row["exploring to 90 %_at most"] for row in rows] == ["28800", ""]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (RUNS[:1], True),
        (RUNS, False),
        # One value has no interval, and episodes of no run have no seed.
        (RUNS[:1, :1], False),
        (RUNS[0], False),
    ],
)
def test_intervals_over_episodes_alone_are_said_to_be_so(
    values: np.ndarray, said: bool
) -> None:
    one = Scores({}, "best", "coverage (%)", values)
    lines = markdown_table(summarize_scores([one], subject="policy")).splitlines()
    assert lines[3:] == (["", ONE_RUN] if said else [])


def test_a_table_of_nothing_is_empty() -> None:
    assert markdown_table(summarize_scores([], subject="policy")) == ""


@pytest.mark.parametrize(
    ("decisions", "median", "share"),
    [
        ([100, 300], 200.0, 1.0),
        ([100, -1, 200, 300], 250.0, 0.75),  # 100, 200, 300, never: between 200, 300
        ([100, 200, -1, -1], math.nan, 0.5),  # between 200 and never
        ([-1], math.nan, 0.0),
        ([0], 0.0, 1.0),
    ],
)
def test_episodes_that_do_not_arrive_count_as_the_longest(
    decisions: list[int], median: float, share: float
) -> None:
    assert decisions_to_reach(decisions) == pytest.approx((median, share), nan_ok=True)


def test_no_episode_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one episode, got none"):
        decisions_to_reach([])
