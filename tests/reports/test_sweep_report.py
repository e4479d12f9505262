import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.sweeps import make_exploration, make_pretraining, make_run, write_table
from toponav.metrics import AtMost, summarize_scores
from toponav.reports import report_exploration, report_pretraining
from toponav.runs import find_runs


def test_pretrainings_are_grouped_by_setting_and_maze(tmp_path: Path) -> None:
    for seed, accuracy in enumerate((0.8, 0.9)):
        make_pretraining(tmp_path, "pairs.k=2", seed=seed, mazes={"select": accuracy})
    make_pretraining(tmp_path, "pairs.k=10", mazes={"select": 0.6})
    report = report_pretraining(find_runs(tmp_path), title="sweep")
    rows = [
        (one.settings, one.subject, one.measure, one.values.tolist())
        for one in report.scores
    ]
    two, ten = {"pairs.k": "2"}, {"pairs.k": "10"}
    assert rows == [
        (two, "select", "TC accuracy (%)", [[80.0], [90.0]]),
        (two, "select", "L accuracy (%)", [[pytest.approx(70)], [pytest.approx(70)]]),
        (ten, "select", "TC accuracy (%)", [[60.0]]),
        (ten, "select", "L accuracy (%)", [[pytest.approx(70)]]),
    ]
    assert report.scores[0].more == pytest.approx(
        {
            "true poses (%)": 98,
            "at k = 4, M = 5 (%)": 75,
            "waypoints at 0.5 (%)": 5,
            "waypoints at 0.9 (%)": 12.5,
        }
    )
    assert report.figure is not None
    (axes,) = report.figure.axes
    assert axes.get_xlabel() == "pairs.k"
    assert axes.get_title(loc="left") == "select"
    assert axes.lines[0].get_ydata().tolist() == pytest.approx([85, 60])


def test_a_sweep_over_mazes_has_one_panel(tmp_path: Path) -> None:
    for maze in ("maze1", "maze2"):
        make_pretraining(tmp_path, f"maze={maze}", mazes={maze: 0.8})
    figure = report_pretraining(find_runs(tmp_path)).figure
    assert figure is not None
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.get_xticklabels()] == ["maze1", "maze2"]


def test_networks_of_several_mazes_have_a_panel_for_each(tmp_path: Path) -> None:
    make_pretraining(tmp_path, "mazes=[a,b]", mazes={"a": 0.9, "b": 0.8})
    report = report_pretraining(find_runs(tmp_path))
    assert [one.subject for one in report.scores] == ["a", "a", "b", "b"]
    assert report.figure is not None
    headings = [axes.get_title(loc="left") for axes in report.figure.axes]
    assert headings == ["a", "b"]


def test_explorations_have_their_policies_and_the_maze_its_levels(
    tmp_path: Path,
) -> None:
    for alpha in ("0.2", "1.0"):
        for seed in (0, 1):
            best = [0.8 + 0.1 * seed, 0.7]
            make_exploration(tmp_path, f"reward.alpha={alpha}", seed=seed, best=best)
    report = report_exploration(find_runs(tmp_path))
    best = report.scores[0]
    assert (best.settings, best.subject) == ({"reward.alpha": "0.2"}, "best")
    np.testing.assert_allclose(best.values, [[80, 70], [90, 70]])
    rows = [(one.settings.get("reward.alpha"), one.subject) for one in report.scores]
    assert rows == [
        *[("0.2", "best"), ("0.2", "last"), ("1.0", "best"), ("1.0", "last")],
        (None, "random"),
    ]
    # All four runs walked the same two random episodes: they count once.
    assert report.scores[-1].values.tolist() == [40.0, 50.0]
    # One of four episodes came to 90 %: no median.
    assert best.more["share to 90 % (%)"] == 25
    assert math.isnan(best.more["decisions to 90 %"])
    assert report.figure is not None
    (axes,) = report.figure.axes
    assert [line.get_label() for line in axes.lines] == [
        "reward.alpha 0.2 (2 runs)",
        "reward.alpha 1.0 (2 runs)",
        "uniform random 45.0",
    ]


def test_random_walks_of_other_seeds_are_put_together(tmp_path: Path) -> None:
    make_exploration(tmp_path, "a=1", seed=0, best=[0.8], random=[0.4, 0.5])
    make_exploration(tmp_path, "a=2", seed=0, best=[0.8], random=[0.4, 0.5])
    make_exploration(tmp_path, "a=1", seed=1, best=[0.8], random=[0.6, 0.5])
    (walk,) = [
        one
        for one in report_exploration(find_runs(tmp_path)).scores
        if one.subject == "random"
    ]
    # Two runs had the same walks; a coverage of two different walks counts twice.
    assert sorted(walk.values.tolist()) == [40.0, 50.0, 50.0, 60.0]


def test_the_training_is_through_when_sixteen_episodes_are(tmp_path: Path) -> None:
    # 0.4 until episode 40, then 1: the mean of 16 is (0.4 j + 16 - j) / 16 with j old
    # ones, and reaches 0.9 at j = 2, with the 14th good episode, the 54th of all.
    make_exploration(tmp_path, best=[0.95], training=1.0)
    report = report_exploration(find_runs(tmp_path))
    assert report.scores[0].more["exploring to 90 %"] == 54 * 1800


def test_who_covers_so_much_from_the_start_has_a_bound(tmp_path: Path) -> None:
    # 20 episodes of 95 %: the first mean of 16 ends with the 16th.
    rows = [{"decisions": 1800 * (n + 1), "coverage": 0.95} for n in range(20)]
    runs = [make_exploration(tmp_path, seed=seed, best=[0.95]) for seed in range(3)]
    write_table(runs[0] / "episodes.csv", rows)
    # The other two are there with the 55th, and so is the median.
    report = report_exploration(find_runs(tmp_path))
    assert report.scores[0].more["exploring to 90 %"] == 55 * 1800
    write_table(runs[1] / "episodes.csv", rows)
    report = report_exploration(find_runs(tmp_path))
    assert report.scores[0].more["exploring to 90 %"] == AtMost(16 * 1800)


def test_a_curve_begins_where_it_is_of_sixteen_episodes(tmp_path: Path) -> None:
    make_exploration(tmp_path, best=[0.95])
    figure = report_exploration(find_runs(tmp_path)).figure
    assert figure is not None
    curve = figure.axes[0].lines[0]
    assert curve.get_xdata()[0] == 16 * 1800
    assert "mean of the last 16 episodes" in figure.axes[0].get_ylabel()


def test_mazes_have_panels_and_levels_of_their_own(tmp_path: Path) -> None:
    for maze, level in (("maze1", 0.5), ("maze3", 0.4)):
        make_exploration(tmp_path, f"maze={maze}", best=[0.8], random=[level])
    figure = report_exploration(find_runs(tmp_path)).figure
    assert figure is not None
    found = {
        axes.get_title(loc="left"): str(axes.lines[-1].get_label())
        for axes in figure.axes
    }
    assert found == {"maze1": "uniform random 50.0", "maze3": "uniform random 40.0"}


def test_random_walks_on_two_engines_stay_apart(tmp_path: Path) -> None:
    for engine, level in (("vizdoom", 0.5), ("dmlab", 0.7)):
        make_exploration(tmp_path, f"engine={engine}", best=[0.8], random=[level])
    scores = report_exploration(find_runs(tmp_path)).scores
    walks = [one for one in scores if one.subject == "random"]
    found = {one.settings["engine"]: one.values.tolist() for one in walks}
    assert found == {"vizdoom": [50.0], "dmlab": [70.0]}


def test_unfinished_runs_are_named_and_left_out(tmp_path: Path) -> None:
    make_exploration(tmp_path, seed=0, best=[0.8, 0.9])
    short = make_exploration(tmp_path, seed=1, best=[0.8])
    missing = make_run(tmp_path, "explore", seed=2)
    report = report_exploration(find_runs(tmp_path))
    assert report.left_out == [
        f"{missing} is left out: it has no evaluation.csv",
        f"{short} is left out: it has 1 evaluation episodes, other runs with its "
        "settings 2",
    ]
    assert [one.values.shape for one in report.scores[:2]] == [(1, 2), (1, 2)]


def test_runs_without_a_best_policy_have_their_last_one(tmp_path: Path) -> None:
    make_exploration(tmp_path, "reward=tc", best=[0.8, 0.9])
    for seed, best in enumerate(([0.95, 1.0], [0.95])):
        folder = make_exploration(tmp_path, "reward=rnd", seed=seed, best=best)
        path = folder / "evaluation.csv"
        path.write_text(re.sub("^best,.*\n", "", path.read_text(), flags=re.MULTILINE))
    report = report_exploration(find_runs(tmp_path))
    assert report.left_out == [
        f"{folder} is left out: it has 1 evaluation episodes, other runs with its "
        "settings 2"
    ]
    found = {(one.settings.get("reward"), one.subject): one for one in report.scores}
    policies = [("rnd", "last"), ("tc", "best"), ("tc", "last"), (None, "random")]
    assert list(found) == policies
    np.testing.assert_allclose(found["rnd", "last"].values, [[85, 90]])
    # The column that only the policy has by which a run is judged.
    judged = [key for key in found if "exploring to 90 %" in found[key].more]
    assert judged == policies[:2]


def test_runs_without_ground_truth_are_left_out(tmp_path: Path) -> None:
    make_exploration(tmp_path, "world=doom", best=[0.8])
    blind = make_exploration(tmp_path, "world=pong", best=[0.8])
    for path in (blind / "evaluation.csv", blind / "episodes.csv"):
        known = pd.read_csv(path).drop(
            columns=["coverage", "decisions_to_90"], errors="ignore"
        )
        known["intrinsic_return"] = 7.0
        known.to_csv(path, index=False)
    report = report_exploration(find_runs(tmp_path))
    sentence = "is left out: it has no coverage: its world has no ground truth"
    assert report.left_out == [f"{blind} {sentence}"]
    assert [one.subject for one in report.scores] == ["best", "last", "random"]


def test_without_any_ground_truth_it_is_of_intrinsic_return(tmp_path: Path) -> None:
    folder = make_exploration(tmp_path, "world=gym", best=[0.8])
    for name in ("evaluation.csv", "episodes.csv"):
        table = pd.read_csv(folder / name).assign(intrinsic_return=7.0)
        table = table.drop(columns=["coverage", "decisions_to_90"], errors="ignore")
        table.to_csv(folder / name, index=False)
    report = report_exploration(find_runs(tmp_path))
    assert (report.left_out, report.figure is None) == ([], False)
    found = {one.subject: one for one in report.scores}
    assert list(found) == ["best", "last", "random"]
    assert {one.measure for one in report.scores} == {"intrinsic return"}
    assert found["best"].values.tolist() == [[7.0]]
    assert found["best"].more == {}


def test_returns_are_shown_whole(tmp_path: Path) -> None:
    folder = make_exploration(tmp_path, "world=gym", best=[0.8])
    returns = np.where(np.arange(80) < 40, -5.0, 300.0)
    for name, values in (("evaluation.csv", 7.0), ("episodes.csv", returns)):
        table = pd.read_csv(folder / name).assign(intrinsic_return=values)
        table = table.drop(columns=["coverage", "decisions_to_90"], errors="ignore")
        table.to_csv(folder / name, index=False)
    figure = report_exploration(find_runs(tmp_path)).figure
    assert figure is not None
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    shown = np.asarray(axes.lines[0].get_ydata())
    assert (shown.min(), shown.max()) == (-5, 300)
    assert low <= -5 < 300 <= high


@pytest.mark.parametrize(
    ("recipe", "report"),
    [("explore", report_exploration), ("pretrain", report_pretraining)],
)
def test_no_finished_run_leaves_no_figure(tmp_path: Path, recipe, report) -> None:
    make_run(tmp_path, recipe)
    found = report(find_runs(tmp_path))
    assert found.scores == []
    assert found.figure is None
    assert len(found.left_out) == 1


def test_what_has_no_number_is_left_out_and_said(tmp_path: Path) -> None:
    known = make_pretraining(tmp_path, "pairs.k=4", mazes={"maze1": 0.75})
    unknown = make_pretraining(tmp_path, "pairs.k=5", mazes={"maze1": 0.5})
    text = (unknown / "report.json").read_text()
    (unknown / "report.json").write_text(text.replace("0.5,", "null,", 1))
    found = report_pretraining(find_runs(tmp_path))
    assert [one.settings["pairs.k"] for one in found.scores] == ["4", "4", "5"]
    assert found.left_out == [
        "TC accuracy (%) of maze1 (pairs.k=5) is left out: some of its values are "
        "missing or no finite numbers"
    ]
    assert len(summarize_scores(found.scores, subject="maze")) == 3
    assert known.exists()
