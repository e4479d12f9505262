"""The practise recipe, run as its users run it."""

import os
import re
import signal
from pathlib import Path
from unittest.mock import patch

import pandas as pd
import pytest
import torch
from PIL import Image

from recipes import practise as recipe
from tests.explored import make_run
from tests.forked import run_forked


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("explored") / "run"
    make_run(folder, poses=True)
    return folder


@pytest.mark.slow
def test_a_practice_leaves_a_controller_that_navigation_takes(run: Path) -> None:
    words = [f"run={run}", "scale=smoke", "hydra.run.dir=practice"]
    done = run_forked("practise", *words, cwd=run)
    assert done.returncode == 0, done.stderr
    assert "controller of 128 decisions written to" in done.stdout
    said = re.search(r"of ([\d,]+) edges ([\d,]+) were passed, and 0 are", done.stdout)
    assert said is not None
    tried = torch.load(run / "practice" / "edge_trials.pt")
    assert int(said[1].replace(",", "")) == len(tried["edges"])
    assert int(said[2]) == int((tried["passed"] > 0).any(1).sum())
    table = pd.read_csv(run / "practice" / "practice.csv")
    # 128 decisions in batches of 2 mazes and 32 decisions.
    assert table["decisions"].tolist() == [64, 128]
    columns = {"progress", "reached", "given up", "entropy", "confirmed", "mistaken"}
    assert columns <= set(table.columns)
    assert min(Image.open(run / "practice" / "practice.png").size) > 200
    words = [f"run={run}", "scale=smoke", "navigator=poses", "hydra.run.dir=tour"]
    words += ["navigator.practised=practice", "evaluate.policies=[navigator]"]
    done = run_forked("navigate", *words, cwd=run)
    assert done.returncode == 0, done.stderr
    assert len(pd.read_csv(run / "tour" / "summary.csv")) == 1


@pytest.mark.slow
def test_one_that_is_stopped_says_what_it_has(run: Path) -> None:
    def stop(*_: object) -> None:
        os.kill(os.getpid(), signal.SIGTERM)

    words = [f"run={run}", "scale=smoke", "hydra.run.dir=stopped"]
    inside = patch.object(recipe, "write_practice", stop)
    done = run_forked("practise", *words, cwd=run, inside=inside)
    assert done.returncode == 128 + signal.SIGTERM
    said = "stopped; the run folder has the controller of the decisions so far"
    assert done.stderr.splitlines()[-1] == said
    assert (run / "stopped" / "controller.pt").is_file()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["practise", "navigator=topological"],
            "navigator must be poses, which alone can practise, got topological",
        ),
        (
            ["practise", "maze.goal=true"],
            "maze.goal must be false: targets are the map's own, got True",
        ),
        (
            ["practise", "navigator.temperature=0"],
            "navigator.temperature must be above 0 to practise, which learns from "
            "draws, got 0.0",
        ),
        (
            ["practise", "navigator.practised=practice"],
            "navigator.practised must be null, as each practice begins afresh, got "
            "practice",
        ),
        (
            ["navigate", "navigator=poses", "navigator.practised=nowhere"],
            "navigator.practised must name a run with controller.pt, got "
            "nowhere/controller.pt",
        ),
    ],
)
def test_what_cannot_be_is_refused(run: Path, words: list[str], said: str) -> None:
    recipe, *overrides = words
    done = run_forked(recipe, f"run={run}", "scale=smoke", *overrides, cwd=run)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
