"""The recipe that makes the paper's tables, run as its users run it."""

import csv
import shutil
from pathlib import Path

import pytest

from tests.forked import run_forked


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["experiment=table33"],
            "experiment must be one of fig14, table1, table2, table3, table4, table5, "
            "table6, table7, table8, table9, got 'table33' (did you mean 'table3'?)",
        ),
        (
            ["rows=[ours]"],
            "rows must name some of novelty, novelty on pixels, ICM, RND, VIME, VIME "
            "on TRPO, EX2, EX2 on TRPO, TRPO without reward, random reward, coverage "
            "(truth), got 'ours'",
        ),
        (
            ["rows=[random reward]", "folder=/proc/table"],
            "the files of a run must be readable and writable, got [Errno 2] No such "
            "file or directory: '/proc/table'",
        ),
    ],
)
def test_what_is_wrong_is_one_sentence(
    words: list[str], sentence: str, tmp_path: Path
) -> None:
    done = run_forked("reproduce", "scale=smoke", *words, cwd=tmp_path)
    assert done.returncode != 0
    assert done.stderr.splitlines()[-1] == f"reproduce: {sentence}"
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("*.*"))


@pytest.mark.slow
def test_a_table_is_made_and_not_made_again(tmp_path: Path) -> None:
    words = ["scale=smoke", "rows=[random reward]", "folder=out"]
    done = run_forked("reproduce", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1 of 1 runs are missing; about 0.2 minutes" in done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *(f"table3.{kind}" for kind in ("csv", "md", "png")),
        "runs",
    }
    with (tmp_path / "out/table3.csv").open(newline="") as file:
        rows = {row["row"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["random reward", "random", "sticky", "frontier"]
    assert all(0 < float(row["coverage (%)"]) < 100 for row in rows.values())
    assert float(rows["frontier"]["coverage (%)"]) > float(
        rows["random"]["coverage (%)"]
    )

    before = (tmp_path / "out/table3.csv").read_text()
    done = run_forked("reproduce", *words, cwd=tmp_path)
    assert "table3: all 1 runs are there" in done.stderr
    assert (tmp_path / "out/table3.csv").read_text() == before

    # Nor is it lost with the runs.
    shutil.rmtree(tmp_path / "runs")
    (tmp_path / "out/table3.csv").unlink()
    done = run_forked("reproduce", *words, "make=false", cwd=tmp_path)
    assert "table3: all 1 runs are there" in done.stderr
    assert (tmp_path / "out/table3.csv").read_text() == before


@pytest.mark.slow
def test_a_name_with_a_dot_is_the_name_of_its_files(tmp_path: Path) -> None:
    words = ["scale=smoke", "rows=[random reward]", "folder=out", "make=false"]
    # And half of one that a killed process was writing is gone.
    (tmp_path / "out").mkdir()
    for kind in ("csv", "md", "png"):
        (tmp_path / "out" / f".table3.5.4242.{kind}").touch()
    done = run_forked("reproduce", *words, "experiment.name=table3.5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "out").glob("*.*")} == {
        f"table3.5.{kind}" for kind in ("csv", "md", "png")
    }
