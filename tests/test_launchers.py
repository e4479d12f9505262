"""Sweeps and tables by launchers of Hydra's for clusters, here on this machine."""

import csv
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.forked import ROOT
from tests.sweeps import files_of, make_folder


def needs(launcher: str, extra: str) -> pytest.MarkDecorator:
    """Skip where a plugin is not installed."""
    plugin = f"hydra_plugins.hydra_{launcher}_launcher"
    missing = not (find_spec("hydra_plugins") and find_spec(plugin))
    name = f"hydra-{launcher}-launcher"
    return pytest.mark.skipif(missing, reason=f"{name} is not installed ({extra})")


SUBMITIT = ("hydra/launcher=submitit_local",)
#: On a cluster of its own.
RAY = ("hydra/launcher=ray",)
#: How many of its runs go at a time; submitit starts all of them.
RAY_RUNS = "+hydra.launcher.ray.init.num_cpus"
IS_THERE = {
    SUBMITIT: needs("submitit", "extra: slurm"),
    RAY: needs("ray", "extra: ray-sweeps"),
}
by_each = pytest.mark.parametrize(
    "launcher",
    [pytest.param(one, marks=mark) for one, mark in IS_THERE.items()],
    ids=["submitit", "ray"],
)


def run(recipe: str, *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A recipe as its users start it: its jobs import it in processes of their own."""
    script = str(ROOT / "recipes" / f"{recipe}.py")
    own = {"PYTHONPATH": str(ROOT), "RAY_USAGE_STATS_ENABLED": "0"}
    # Otherwise Ray writes a token into the user's home.
    own["RAY_AUTH_MODE"] = "disabled"
    return subprocess.run(
        [sys.executable, script, "-m", "scale=smoke", *words],
        cwd=cwd,
        env={**os.environ, **own},
        capture_output=True,
        text=True,
        timeout=280,
    )


@pytest.mark.slow
@by_each
def test_a_job_that_is_refused_says_so_and_the_others_go_on(
    launcher: tuple[str, ...], tmp_path: Path
) -> None:
    words = [*launcher, "maze=maze1", "maze.blocked=[a],[z]", "hydra.sweep.dir=sweep"]
    words += [f"{RAY_RUNS}=1"] * (launcher is RAY)
    done = run("tour", *words, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "blocked slots must be slots of maze1 (a, b), got 'z'" in done.stderr
    (made,) = (tmp_path / "sweep").rglob("plan.png")
    assert "blocked=a" in made.parent.name


@pytest.mark.slow
@by_each
def test_a_refused_job_leaves_the_settings_of_the_run_that_has_its_folder(
    launcher: tuple[str, ...], tmp_path: Path
) -> None:
    folder = tmp_path / "sweep" / "0"
    kept = make_folder(folder, "walk.gif", "config/hydra.yaml", "tour.log")
    words = [*launcher, "hydra.sweep.dir=sweep", "hydra.sweep.subdir=${seed}"]
    words += [f"{RAY_RUNS}=1"] * (launcher is RAY)
    done = run("tour", *words, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "must name a folder without results of another run" in done.stderr
    assert files_of(folder) == kept


@pytest.mark.slow
@IS_THERE[SUBMITIT]
def test_a_sweep_is_jobs_of_submitit(tmp_path: Path) -> None:
    words = [*SUBMITIT, "reward=coverage", "seed=0,1", "hydra.sweep.dir=sweep"]
    done = run("explore", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for seed in (0, 1):
        (folder,) = (tmp_path / "sweep").glob(f"*seed={seed}*")
        assert (folder / "policy.pt").is_file()
        assert (folder / "config" / "config.yaml").is_file()
    # A job of submitit's for each, with what it said.
    said = [
        file.read_text() for file in (tmp_path / "sweep").rglob(".submitit/**/*.out")
    ]
    assert len(said) == 2
    assert all("1,024 decisions in" in text for text in said)


@pytest.mark.slow
@by_each
def test_two_jobs_make_a_table(launcher: tuple[str, ...], tmp_path: Path) -> None:
    rows = "rows=[random reward,'coverage (truth)']"
    words = [*launcher, "worker=0,1", rows, "folder=out"]
    words += [f"{RAY_RUNS}=2"] * (launcher is RAY)
    done = run("reproduce", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "out/table3.csv").open(newline="") as file:
        table = {row["row"]: row for row in csv.DictReader(file)}
    for label in ("random reward", "coverage (truth)"):
        assert table[label]["runs"] == "1 of 1"
        assert 0 < float(table[label]["coverage (%)"]) < 100
    # Each run was made once, and one began before the other ended: of a job that makes
    # one at a time, they are the work of two.
    ended = {path.parent: path for path in (tmp_path / "runs").rglob("policy.pt")}
    assert len(ended) == 2
    last_begin = max(when(folder / "config" / "config.yaml") for folder in ended)
    assert last_begin < min(when(path) for path in ended.values())


def when(path: Path) -> float:
    return path.stat().st_mtime
