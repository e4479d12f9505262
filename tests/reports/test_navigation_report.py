from pathlib import Path

import pytest

from tests.sweeps import make_run
from toponav.reports import report_navigation
from toponav.runs import find_runs

COLUMNS = "policy,episode,goals,reward,first_goal,spl,replans,lost"


def make_navigation(folder: Path, *given: str, seed: int = 0, **goals: list[int]):
    """A run whose policies reached so many goals in their episodes."""
    run = make_run(folder, "navigate", *given, seed=seed)
    rows = [
        f"{policy},{number},{count},{10 * count},{40 if count else -1},0.5,0,0"
        for policy, counts in goals.items()
        for number, count in enumerate(counts)
    ]
    (run / "episodes.csv").write_text("\n".join([COLUMNS, *rows]) + "\n")
    return run


def test_goals_are_grouped_by_closed_slots_and_policy(tmp_path: Path) -> None:
    for seed, counts in enumerate(([4, 6], [0, 10])):
        make_navigation(tmp_path, "maze.blocked=[a]", seed=seed, navigator=counts)
    make_navigation(tmp_path, "maze.blocked=[]", navigator=[8, 8], oracle=[20, 22])
    report = report_navigation(find_runs(tmp_path))
    rows = [
        (one.settings["maze.blocked"], one.subject, one.values.tolist())
        for one in report.scores
    ]
    assert rows == [
        ("[]", "navigator", [[8, 8]]),
        ("[]", "oracle", [[20, 22]]),
        ("[a]", "navigator", [[4, 6], [0, 10]]),
    ]
    # One of four episodes came to no goal.
    assert report.scores[2].more == pytest.approx(
        {"reached the goal (%)": 75, "SPL (%)": 50}
    )
    assert report.figure is not None
    (axes,) = report.figure.axes
    assert axes.get_xlabel() == "maze.blocked"


def test_what_is_shown_makes_no_group(tmp_path: Path) -> None:
    make_navigation(tmp_path, "evaluate.policies=[navigator]", navigator=[1, 2])
    make_navigation(tmp_path, "video.decisions=0", navigator=[3, 4])
    (score,) = report_navigation(find_runs(tmp_path)).scores
    assert score.settings == {}
    assert sorted(score.values.tolist()) == [[1, 2], [3, 4]]


def test_all_columns_are_of_the_episodes_that_all_runs_have(tmp_path: Path) -> None:
    for seed, counts in enumerate(([4, 6], [2, 8, 0])):
        make_navigation(tmp_path, seed=seed, navigator=counts)
    (score,) = report_navigation(find_runs(tmp_path)).scores
    assert score.values.tolist() == [[4, 6], [2, 8]]
    # The third one of the second run came to no goal.
    assert score.more["reached the goal (%)"] == 100


def test_unfinished_evaluations_are_named_and_left_out(tmp_path: Path) -> None:
    run = make_run(tmp_path, "navigate")
    report = report_navigation(find_runs(tmp_path))
    assert report.figure is None
    assert report.left_out == [f"{run} is left out: it has no episodes.csv"]
