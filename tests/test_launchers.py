"""Sweeps and tables by launchers of Hydra's for clusters, here on this machine."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.forked import ROOT

pytest.importorskip(
    "hydra_plugins.hydra_submitit_launcher",
    reason="hydra-submitit-launcher is not installed (extra: slurm)",
)
LOCAL = ("-m", "hydra/launcher=submitit_local", "scale=smoke")


def run(recipe: str, *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A recipe as its users start it: its jobs import it in processes of their own."""
    script = str(ROOT / "recipes" / f"{recipe}.py")
    return subprocess.run(
        [sys.executable, script, *LOCAL, *words],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=280,
    )


@pytest.mark.slow
def test_a_sweep_is_jobs_of_submitit(tmp_path: Path) -> None:
    words = ["reward=coverage", "seed=0,1", "hydra.sweep.dir=sweep"]
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
def test_jobs_share_the_runs_of_a_table(tmp_path: Path) -> None:
    words = ["worker=0,1", "rows=[random reward]", "folder=out"]
    done = run("reproduce", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "table3.csv").is_file()
    # One run was missing, and one was made.
    assert len(list((tmp_path / "runs").rglob("policy.pt"))) == 1
