"""The report recipe, run as its users run it."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from tests.forked import run_forked
from tests.sweeps import make_exploration, make_pretraining, make_run

RECIPE = Path(__file__).parent.parent / "recipes" / "report.py"


def report(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(RECIPE), *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.slow
def test_a_sweep_gets_a_table_and_a_figure(tmp_path: Path) -> None:
    sweep = tmp_path / "multirun" / "explore" / "20260101"
    for seed in (0, 1):
        make_exploration(sweep, "maze=maze3", seed=seed, best=[0.9, 0.8 + 0.1 * seed])
    missing = make_run(sweep, "explore", "maze=maze3", seed=2)
    before = set(tmp_path.rglob("*"))
    done = report(tmp_path, "multirun/explore/20260101")
    assert done.returncode == 0, done.stderr
    sentence = f"{missing.relative_to(tmp_path)} is left out: it has no evaluation.csv"
    assert done.stderr.strip() == sentence

    names = {path.name for path in set(tmp_path.rglob("*")) - before}
    assert names == {"report.md", "report.csv", "report.png"}
    table, _, entries = (sweep / "report.md").read_text().rpartition("\n\n")
    assert done.stdout.startswith(table)
    assert entries == f"- {sentence}\n"
    with (sweep / "report.csv").open(newline="") as file:
        rows = {row["policy"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["best", "last", "random"]
    assert float(rows["best"]["mean"]) == pytest.approx(87.5)
    assert (rows["best"]["runs"], rows["best"]["episodes"]) == ("2", "4")
    assert min(Image.open(sweep / "report.png").size) > 400


@pytest.mark.slow
def test_the_five_best_draws_stand_below_the_table(tmp_path: Path) -> None:
    for seed in range(6):
        folder = make_exploration(tmp_path, seed=seed, best=[0.5 + 0.05 * seed])
        (folder / "config/draws.yaml").write_text(f"loss.lr: {(seed + 1) / 1000}\n")
    done = run_forked("report", ".", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    table, _, entries = (tmp_path / "report.md").read_text().partition("\n\n")
    assert "| top 5 draws |" in table.splitlines()[0]
    lines = entries.splitlines()
    assert lines[0] == "- best draw 1 of best, coverage (%): 75.0, loss.lr 0.006"
    assert len(lines) == 10  # five of each of the two policies
    with (tmp_path / "report.csv").open(newline="") as file:
        first = next(csv.DictReader(file))
    # All six, and all but the worst.
    assert float(first["mean"]) == pytest.approx(62.5)
    assert float(first["top_5_draws"]) == pytest.approx(65.0)


@pytest.mark.slow
def test_half_a_table_of_a_process_that_was_killed_is_removed(tmp_path: Path) -> None:
    make_exploration(tmp_path, best=[0.9])
    kept = tmp_path / ".other.4242.md"
    halves = [tmp_path / f".report.4242.{kind}" for kind in ("md", "csv", "png")]
    for path in (kept, *halves):
        path.touch()
    done = run_forked("report", ".", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.glob(".*")) == [kept]


@pytest.mark.slow
def test_a_folder_with_runs_of_both_recipes_gets_two(tmp_path: Path) -> None:
    make_exploration(tmp_path / "a=1,b=2", best=[0.9])
    make_pretraining(tmp_path / "a=1,b=2", "k=2", mazes={"select": 0.9})
    done = run_forked("report", "folder=a=1,b=2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = {path.name for path in (tmp_path / "a=1,b=2").glob("report*")}
    kinds = ("csv", "md", "png")
    assert found == {
        f"report_{name}.{kind}" for name in ("explore", "pretrain") for kind in kinds
    }


@pytest.mark.slow
def test_without_runs_there_is_one_sentence(tmp_path: Path) -> None:
    done = run_forked("report", "nowhere", cwd=tmp_path)
    assert done.stderr.strip() == (
        "report: folder must name the folder of a sweep or a run, got 'nowhere'"
    )
    assert done.returncode == 2
    assert not list(tmp_path.iterdir())
    folder = make_run(tmp_path, "explore")
    done = run_forked("report", folder.name, cwd=tmp_path)
    assert done.stderr.splitlines() == [
        f"{folder.name} is left out: it has no evaluation.csv",
        "report: folder must hold a finished run of explore or navigate or pretrain, "
        f"got none in '{folder.name}'",
    ]
    assert done.returncode == 2


def test_too_many_bootstrap_samples_are_one_sentence(tmp_path: Path) -> None:
    make_exploration(tmp_path / "runs", best=[0.9])
    done = run_forked("report", "runs", f"draws={2**63 - 1}", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        f"report: draws must be at most 1,000,000, got {2**63 - 1}\n",
    )


@pytest.mark.slow
def test_a_scale_says_how_many_bootstrap_samples(tmp_path: Path) -> None:
    make_exploration(tmp_path / "runs", best=[0.9, 0.3, 0.8, 0.4, 0.5])
    tables = []
    for words in ((), ("scale=laptop",), ("scale=smoke",), ("draws=200",)):
        done = run_forked("report", "runs", *words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        tables.append((tmp_path / "runs" / "report.csv").read_text())
    usual, laptop, smoke, few = tables
    assert usual == laptop != smoke == few
