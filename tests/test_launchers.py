"""Sweeps and tables by launchers of Hydra's for clusters, here on this machine."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.forked import ROOT


def needs(launcher: str, extra: str) -> pytest.MarkDecorator:
    """Skip where a plugin is not installed."""
    plugin = f"hydra_plugins.hydra_{launcher}_launcher"
    missing = not (find_spec("hydra_plugins") and find_spec(plugin))
    name = f"hydra-{launcher}-launcher"
    return pytest.mark.skipif(missing, reason=f"{name} is not installed ({extra})")


SUBMITIT = ("hydra/launcher=submitit_local",)
#: One run after the other, on a cluster of its own.
RAY = ("hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=1")


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
@needs("submitit", "extra: slurm")
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
@needs("submitit", "extra: slurm")
def test_jobs_share_the_runs_of_a_table(tmp_path: Path) -> None:
    words = [*SUBMITIT, "worker=0,1", "rows=[random reward]", "folder=out"]
    done = run("reproduce", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "table3.csv").is_file()
    # One run was missing, and one was made.
    assert len(list((tmp_path / "runs").rglob("policy.pt"))) == 1


@pytest.mark.slow
@needs("ray", "extra: ray-sweeps")
def test_a_sweep_is_tasks_of_ray(tmp_path: Path) -> None:
    words = [*RAY, "maze=maze1", "maze.blocked=[a],[z]", "hydra.sweep.dir=sweep"]
    done = run("tour", *words, cwd=tmp_path)
    # One is refused, in words, and the other made.
    assert done.returncode == 2, done.stderr
    assert "blocked slots must be slots of maze1 (a, b), got 'z'" in done.stderr
    assert len(list((tmp_path / "sweep").rglob("plan.png"))) == 1
