"""A cell of a run's tables that is damaged is a sentence, or makes no difference."""

import csv
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.sweeps import make_exploration, make_pretraining, make_run, write_table
from toponav.experiments.found_runs import is_finished
from toponav.metrics import csv_table, markdown_table, summarize_scores
from toponav.reports import report_exploration, report_navigation, report_pretraining
from toponav.runs import find_runs


def explored(sweep: Path, seed: int) -> Path:
    return make_exploration(sweep, seed=seed, best=[0.9, 0.8])


def pretrained(sweep: Path, seed: int) -> Path:
    return make_pretraining(sweep, seed=seed, mazes={"select": 0.9})


def navigated(sweep: Path, seed: int) -> Path:
    folder = make_run(sweep, "navigate", seed=seed)
    row = {"policy": "navigator", "goals": 3, "reward": 31.0}
    row |= {"first_goal": 5, "spl": 0.5}
    write_table(folder / "episodes.csv", [row, row])
    (folder / "summary.csv").touch()
    return folder


REPORTS = {
    explored: report_exploration,
    pretrained: report_pretraining,
    navigated: report_navigation,
}


@pytest.mark.parametrize(
    ("make", "file"),
    [
        (explored, "evaluation.csv"),
        (explored, "episodes.csv"),
        (pretrained, "metrics.csv"),
        (navigated, "episodes.csv"),
    ],
)
@pytest.mark.parametrize("damage", ["x", "nan", "inf"])
def test_a_damaged_cell_is_no_error(
    tmp_path: Path, make: Callable[[Path, int], Path], file: str, damage: str
) -> None:
    make(tmp_path, 0)
    path = make(tmp_path, 1) / file
    with path.open(newline="") as table:
        rows = list(csv.DictReader(table))
    for column in rows[0]:
        write_table(path, [{**rows[0], column: damage}, *rows[1:]])
        report = REPORTS[make](find_runs(tmp_path))
        found = summarize_scores(
            report.scores, subject=report.subject, unit=report.unit, draws=5
        )
        assert markdown_table(found).startswith("|")
        assert csv_table(found)
        # What is left out is one of them, if any.
        assert len(report.left_out) <= 1
        assert all(str(path.parent) in said for said in report.left_out)


@pytest.mark.parametrize(
    ("make", "file"),
    [
        (explored, "evaluation.csv"),
        (explored, "episodes.csv"),
        (pretrained, "metrics.csv"),
        (pretrained, "report.json"),
        (navigated, "episodes.csv"),
    ],
)
@pytest.mark.parametrize(
    "damage",
    [b"\xff", b"\n\0\0\0\n", b"1" * 200_000],
    ids=["no text", "zeros", "long"],
)
def test_a_run_with_a_damaged_file_is_left_out(
    tmp_path: Path, make: Callable[[Path, int], Path], file: str, damage: bytes
) -> None:
    make(tmp_path, 0)
    path = make(tmp_path, 1) / file
    whole = path.read_bytes()
    for at in (0, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:at] + damage + whole[at:])
        report = REPORTS[make](find_runs(tmp_path))
        assert report.scores
        (said,) = report.left_out
        assert said.startswith(f"{path.parent} is left out: it has ")
        assert "\n" not in said
        assert not is_finished(path.parent)
