"""Rows over all mazes of a table, by numbers that can be worked out by hand."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.sweeps import make_exploration
from toponav.config import RowConfig
from toponav.reports import Group, best_sentences, explore_table

ROWS = [RowConfig(label="base"), RowConfig(label="other", against="base")]


def explored(folder: Path, maze: str, row: RowConfig, last: list[list[float]]) -> Group:
    """Runs of seeds 0, 1, ... whose last policies cover so much in each episode."""
    at = folder / maze / row.label
    runs = {
        seed: make_exploration(at, seed=seed, best=[one + 0.1 for one in values])
        for seed, values in enumerate(last)
    }
    return Group(row.label, maze, runs, wanted=2, against=row.against)


@pytest.fixture
def groups(tmp_path: Path) -> list[Group]:
    base, other = ROWS
    return [
        explored(tmp_path, "maze1", base, [[0.5, 0.5], [0.7, 0.9]]),
        # Its second run is missing.
        explored(tmp_path, "maze2", base, [[0.6, 0.6]]),
        explored(tmp_path, "maze1", other, [[0.4, 0.5], [0.8, 0.9]]),
        explored(tmp_path, "maze2", other, [[0.7, 0.8], [0.5, 0.5]]),
    ]


def test_mazes_count_alike_and_differences_are_of_equal_mazes_and_seeds(
    groups: list[Group],
) -> None:
    table = explore_table(groups, {}, draws=50)
    pooled = table[table["maze"] == "all mazes"].set_index("row")
    assert list(pooled.index) == ["base", "other"]
    # Seed 0 alone has both mazes: (50 + 60) / 2.
    assert pooled.loc["base", "coverage (%)"].value == pytest.approx(55)
    assert pooled.loc["base", "runs"] == "2 of 4"
    # (40 + 50 + 80 + 90) / 4 = 65 and (70 + 80 + 50 + 50) / 4 = 62.5.
    assert pooled.loc["other", "coverage (%)"].value == pytest.approx(63.75)
    assert pooled.loc["other", "runs"] == "4 of 4"
    # Of seed 0: (-10 + 0) / 2 in maze1, (10 + 20) / 2 in maze2, and (-5 + 15) / 2.
    found = pooled.loc["other", "difference (%)"]
    assert found.value == pytest.approx(5)
    # Its mazes are not drawn: (-10 + 10) / 2 is the least, (0 + 20) / 2 the most.
    assert 0 <= found.low < 5 < found.high <= 10
    # As many decisions of the training in both.
    assert pooled.loc["other", "saved to 90 %"].value == 0


def test_one_maze_has_no_row_over_all(groups: list[Group]) -> None:
    table = explore_table([groups[0], groups[2]], {}, draws=50)
    assert list(table["maze"]) == ["maze1", "maze1"]
    assert best_sentences(ROWS, table) == []


def test_mazes_without_a_common_seed_leave_a_gap(groups: list[Group]) -> None:
    only = Group("base", "maze1", {1: groups[0].runs[1]}, wanted=2)
    table = explore_table([only, groups[1]], {}, draws=50)
    last = table.iloc[-1]
    assert (last["maze"], last["runs"]) == ("all mazes", "0 of 4")
    assert str(last["coverage (%)"]) == "nan"


def test_the_best_row_is_named_with_its_lead(
    groups: list[Group], tmp_path: Path
) -> None:
    worse = RowConfig(label="worse", against="base")
    low = [explored(tmp_path, maze, worse, [[0.3, 0.3]]) for maze in ("maze1", "maze2")]
    table = explore_table([*groups, *low], {}, draws=50)
    (sentence,) = best_sentences([*ROWS, worse], table)
    # Of seed 0, which both mazes have of both rows.
    start = "over all mazes 'other' covers most of the rows beside 'base': "
    one = "5.0 points more than it (of one seed, which says nothing about others)"
    assert sentence == f"{start}{one}"
    assert table.iloc[-2]["difference (%)"].of_one_run
    # Rows that are compared with different ones have no best.
    rows = [*ROWS, RowConfig(label="third", against="other")]
    assert best_sentences(rows, table) == []


def test_a_lead_of_several_seeds_is_sure_or_not(groups: list[Group]) -> None:
    base, _, other, _ = groups
    # The same runs stand for another maze: (-10 + 0) / 2 of seed 0, (10 + 0) / 2 of 1.
    again = [replace(one, maze="maze3") for one in (base, other)]
    table = explore_table([base, other, *again], {}, draws=50)
    (sentence,) = best_sentences(ROWS, table)
    assert ": 0.0 points " in sentence
    assert sentence.endswith(", which includes 0)")
