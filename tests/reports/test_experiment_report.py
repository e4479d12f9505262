"""The table of an experiment, by numbers that can be worked out by hand."""

import csv
import io
import math
from pathlib import Path

import pytest

from tests.sweeps import make_exploration, make_pretraining, write_table
from toponav.config import ExperimentConfig, PaperConfig, RowConfig, SettingsError
from toponav.metrics import AtMost
from toponav.reports import (
    Group,
    experiment_accuracies,
    experiment_csv,
    experiment_curves,
    experiment_markdown,
    explore_table,
    pretrain_table,
    require_columns,
)


def explored(tmp_path: Path, row: str, last: list[list[float]], **more) -> Group:
    """Runs of seeds 0, 1, ... whose last policies cover so much in each episode."""
    runs = {
        seed: make_exploration(
            tmp_path / row, seed=seed, best=[one + 0.1 for one in values]
        )
        for seed, values in enumerate(last)
    }
    return Group(row, "maze3", runs, wanted=len(last), **more)


def test_the_last_policies_are_summed_up(tmp_path: Path) -> None:
    paper = {"best episode (%)": 91.64, "training to 100 %": math.inf}
    group = explored(tmp_path, "ours", [[0.5, 0.7], [0.8, 0.6]], paper=paper)
    row = explore_table([group], {}, draws=50).iloc[0]
    # (50 + 70 + 80 + 60) / 4
    assert row["coverage (%)"].value == pytest.approx(65.0)
    assert row["coverage (%)"].low < 65 < row["coverage (%)"].high
    # The middle half of 50, 60, 70, 80.
    assert row["IQM (%)"].value == pytest.approx(65.0)
    assert row["best episode (%)"] == pytest.approx(80.0)
    assert math.isnan(row["top 5 (%)"])
    assert row["runs"] == "2 of 2"
    assert row["paper: best episode (%)"] == 91.64


def test_pre_training_counts_as_training(tmp_path: Path) -> None:
    group = explored(tmp_path, "ours", [[0.5]], before=1e6)
    row = explore_table([group], {}, draws=50).iloc[0]
    # 40 episodes of 40 %, then 95 %: m of the last 16 at 95 and the others at 40 have a
    # mean of 90 from m = 15 on (40 + 55 m / 16 = 91.6): the 55th episode, and of 50
    # from m = 3 on (50.3): the 43rd. 1,800 decisions each. No episode has all.
    assert row["training to 90 %"] == 1e6 + 55 * 1800
    assert row["training to 50 %"] == 1e6 + 43 * 1800
    assert math.isnan(row["training to 100 %"])


def test_differences_are_of_equal_seeds(tmp_path: Path) -> None:
    plain = explored(tmp_path, "plain", [[0.5, 0.5], [0.7, 0.9]])
    noisy = explored(tmp_path, "noisy", [[0.4, 0.5]], against="plain")
    rows = explore_table([plain, noisy], {}, draws=50).set_index("row")
    # Seed 0 alone: (40 - 50 + 50 - 50) / 2.
    assert rows["difference (%)"]["noisy"].value == pytest.approx(-5.0)
    assert isinstance(rows["difference (%)"]["plain"], float)


def test_what_fine_tuning_saves_is_of_equal_seeds(tmp_path: Path) -> None:
    plain = explored(tmp_path, "plain", [[0.5], [0.5]], before=1000.0)
    tuned = explored(tmp_path, "tuned", [[0.5], [0.5]], against="plain", before=200.0)
    # Both to 90 % after as many decisions of their own; 1000 - 200 of pre-training.
    rows = explore_table([plain, tuned], {}, draws=50).set_index("row")
    assert rows["saved to 90 %"]["tuned"].value == pytest.approx(800.0)
    episodes = tuned.runs[1] / "episodes.csv"
    episodes.write_text("decisions,coverage\n" + "1800,0.5\n" * 20)
    # One that never gets there saves nobody knows how much.
    rows = explore_table([plain, tuned], {}, draws=50).set_index("row")
    assert "saved to 90 %" not in rows


def test_decisions_are_saved_to_each_level_that_all_runs_reach(tmp_path: Path) -> None:
    plain = explored(tmp_path, "plain", [[0.5]], before=1000.0)
    run = make_exploration(tmp_path / "tuned", best=[0.6], training=1.0)
    tuned = Group("tuned", "maze3", {0: run}, wanted=1, against="plain", before=200.0)
    row = explore_table([plain, tuned], {}, draws=50).iloc[1]
    # To 50 %, both need 3 of the last 16 episodes to be good (40 + 60 * 3 / 16 = 51.3),
    # which leaves the 1000 - 200 of the pre-training.
    assert row["saved to 50 %"].value == 800
    # To 90 %, 14 of 16 (40 + 60 * 14 / 16 = 92.5) instead of 15: one episode less.
    assert row["saved to 90 %"].value == 1800 + 800
    # No episode of the other one covers everything.
    assert "saved to 100 %" not in row


def test_who_covers_so_much_from_the_start_has_a_bound(tmp_path: Path) -> None:
    plain = explored(tmp_path, "plain", [[0.5]], before=1e6)
    early = explored(tmp_path, "early", [[0.5]], before=1e6, against="plain")
    # The first mean of 16 episodes is 95 % already.
    rows = [{"decisions": 1800 * (n + 1), "coverage": 0.95} for n in range(20)]
    for group in (plain, early):
        write_table(group.runs[0] / "episodes.csv", rows)
    table = explore_table([plain, early], {}, draws=50)
    assert list(table["training to 90 %"]) == [AtMost(1e6 + 16 * 1800)] * 2
    columns = ["training to 50 %", "training to 100 %"]
    line = experiment_markdown(table, columns).splitlines()[2]
    assert [cell.strip() for cell in line.split("|")[3:5]] == ["at most 1,028,800", "-"]
    (row, _) = csv.DictReader(io.StringIO(experiment_csv(table)))
    assert row["training to 50 %"] == ""
    assert float(row["training to 50 % at most"]) == 1028800
    # Two bounds have no difference.
    assert "saved to 50 %" not in table
    # Of one that begins with less it is known, 55 episodes, but not what it saves.
    later = explored(tmp_path, "later", [[0.5]], before=1e6, against="early")
    table = explore_table([early, later], {}, draws=50).set_index("row")
    assert table["training to 90 %"]["later"] == 1e6 + 55 * 1800
    assert "saved to 90 %" not in table


def test_a_reward_is_a_cell_that_an_episode_visits(tmp_path: Path) -> None:
    paper = {"reward": 586.32}
    group = explored(tmp_path, "ours", [[0.5, 0.7]], paper=paper, cells=60)
    rows = [{"policy": "frontier", "coverage": 0.9}]
    table = explore_table([group], {"maze3": rows}, draws=50).set_index("row")
    # (50 + 70) / 2 = 60 % of 60 cells, and 90 %.
    assert [one.value for one in table["reward"]] == pytest.approx([36, 54])
    assert table.loc["ours", "paper: reward"] == 586.32
    text = experiment_markdown(table.reset_index(), ["reward"])
    assert "paper: reward" in text
    assert "586" in text


def test_scripted_policies_are_rows_and_missing_runs_leave_gaps(tmp_path: Path) -> None:
    group = Group("ours", "maze3", {}, wanted=2)
    coverages, taken = [0.3, 0.5, 1.0], [-1, 900, 500]
    rows = [
        {"policy": "frontier", "coverage": cover, "decisions_to_50": decisions}
        for cover, decisions in zip(coverages, taken, strict=True)
    ]
    table = explore_table([group], {"maze3": rows}, draws=50)
    assert list(table["row"]) == ["ours", "frontier"]
    assert table["coverage (%)"][1].value == pytest.approx(60.0)
    # One never, 900 and 500: the middle one.
    assert table["decisions to 50 %"][1] == 900.0
    text = experiment_markdown(table, ["coverage (%)", "decisions to 50 %"])
    lines = [[cell.strip() for cell in line.split("|")] for line in text.splitlines()]
    assert lines[2][1:6] == ["maze3", "ours", "-", "-", "0 of 2"]
    assert lines[3][4:6] == ["900", "-"]
    figure = experiment_curves([group], {"maze3": rows}, title="")
    assert len(figure.axes) == 1


def test_curves_begin_after_the_pre_training_where_it_is_known(tmp_path: Path) -> None:
    groups = [
        explored(tmp_path, "known", [[0.5]], before=1000.0),
        explored(tmp_path, "unknown", [[0.5]], before=math.nan),
    ]
    (axes,) = experiment_curves(groups, {}, title="").axes
    names = [line.get_label() for line in axes.lines]
    assert names == ["known (1 run)", "unknown, without its pre-training (1 run)"]
    # With the 16th episode, from which on the mean is one of 16.
    begins = [line.get_xdata()[0] for line in axes.lines]
    assert begins == [1000 + 16 * 1800, 16 * 1800]


def test_rows_of_one_run_have_a_sentence(tmp_path: Path) -> None:
    one = explored(tmp_path, "one", [[0.5, 0.7]])
    two = explored(tmp_path, "two", [[0.5, 0.7], [0.8, 0.6]])
    sentence = "intervals are over episodes alone and say nothing about other seeds"
    for groups, said in (([one, two], True), ([two], False)):
        table = explore_table(groups, {}, draws=50)
        text = experiment_markdown(table, ["coverage (%)"])
        assert text.rstrip().endswith(sentence) == said


def test_the_csv_has_the_ends_of_intervals(tmp_path: Path) -> None:
    paper = {"training to 100 %": math.inf}
    group = explored(tmp_path, "ours", [[0.5, 0.7], [0.8, 0.6]], paper=paper)
    table = explore_table([group], {}, draws=50)
    (row,) = csv.DictReader(io.StringIO(experiment_csv(table)))
    low, value, high = (
        float(row[f"coverage (%){end}"]) for end in (" low", "", " high")
    )
    assert low < value == 65.0 < high
    assert row["paper: training to 100 %"] == "inf"
    assert "never" in experiment_markdown(table, ["training to 100 %"])


def test_accuracies_are_means_over_the_mazes(tmp_path: Path) -> None:
    runs = {
        seed: make_pretraining(
            tmp_path, seed=seed, mazes={"maze1": 0.8 + seed / 10, "maze2": 1.0}
        )
        for seed in (0, 1)
    }
    table = pretrain_table([Group("k = 4", "both", runs, 2)], draws=50)
    row = table.iloc[0]
    # Seed 0: (80 + 100) / 2; seed 1: (90 + 100) / 2.
    assert row["TC accuracy (%)"].value == pytest.approx(92.5)
    # (3 * 80 + 1 * 40) / 4
    assert row["L accuracy (%)"].value == pytest.approx(70.0)
    # At the largest threshold.
    assert row["waypoints (%)"].value == pytest.approx(12.5)
    assert experiment_accuracies([Group("k = 4", "both", runs, 2)], title="").axes


def test_an_unknown_column_is_refused() -> None:
    experiment = ExperimentConfig(
        name="some",
        title="",
        recipe="explore",
        mazes=["maze1"],
        overrides=[],
        rows=[RowConfig(label="ours")],
        scripted=[],
        columns=["coverage (%)"],
        paper=[PaperConfig(row="ours", maze="maze1", values={"IQM (%)": 1.0})],
        remarks=[],
    )
    require_columns(experiment)
    experiment.columns.append("goals")
    with pytest.raises(
        SettingsError, match=r"columns must be some of coverage.*'goals'"
    ):
        require_columns(experiment)
