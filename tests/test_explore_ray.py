"""An exploration by Ray, run as its users run it."""

import csv
import operator
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from tests.forked import ROOT

pytest.importorskip("ray", reason="Ray is not installed (extra: ray)")


def explore(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    script = str(ROOT / "recipes" / "explore.py")
    words = ("scale=smoke", "reward=coverage", f"hydra.run.dir={folder}", *words)
    return subprocess.run(
        [sys.executable, script, *words],
        cwd=folder.parent,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=280,
    )


@pytest.mark.slow
def test_it_does_what_local_processes_do(tmp_path: Path) -> None:
    # In step with the learner and with one process, a run is the same every time.
    policies = []
    for backend in ("local", "ray"):
        folder = tmp_path / backend
        done = explore(folder, f"collect.backend={backend}")
        assert done.returncode == 0, done.stderr
        policies.append(torch.load(folder / "policy.pt", weights_only=True))
    local, ray = (torch.utils._pytree.tree_leaves(one) for one in policies)
    assert len(local) == len(ray) > 10
    for one, other in zip(local, ray, strict=True):
        equal = torch.equal if isinstance(one, torch.Tensor) else operator.eq
        assert equal(one, other)


@pytest.mark.slow
def test_a_run_is_resumed_by_ray(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    done = explore(folder, "collect.backend=ray", "collect.decisions=512")
    assert done.returncode == 0, done.stderr
    done = explore(folder, f"resume={folder}", "collect.decisions=1024")
    assert done.returncode == 0, done.stderr
    # It goes on where it was: rows of 256 decisions, none of them twice.
    with (folder / "metrics.csv").open(newline="") as file:
        rows = [int(row["decisions"]) for row in csv.DictReader(file)]
    assert rows == [256, 512, 768, 1024]
    assert "1,024 decisions in" in done.stdout
