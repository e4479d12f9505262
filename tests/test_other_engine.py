"""Recipes on an engine with views, cells and action names of its own."""

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project with the fake engine's room and its registry line."""
    house = tmp_path_factory.mktemp("house")
    for folder in ("toponav", "conf", "recipes"):
        shutil.copytree(ROOT / folder, house / folder)
    engines = house / "toponav" / "envs" / "engines"
    (engines / "fake").mkdir()
    shutil.copy(ROOT / "tests/envs/fake_engine.py", engines / "fake" / "__init__.py")
    face = engines / "__init__.py"
    head, rest = face.read_text(encoding="utf-8").split("ENGINES = {\n")
    line = '    "fake": "toponav.envs.engines.fake",\n'
    face.write_text(f"{head}ENGINES = {{\n{line}{rest}", encoding="utf-8")
    return house


def run(house: Path, recipe: str, *words: str) -> None:
    command = [sys.executable, f"recipes/{recipe}.py", "scale=smoke", *words]
    done = subprocess.run(
        command,
        cwd=house,
        env={**os.environ, "PYTHONPATH": str(house)},
        capture_output=True,
        text=True,
        timeout=290,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_every_recipe_runs_on_an_engine_with_other_actions(house: Path) -> None:
    """It has no action forward, and none that moves and turns at once."""
    small = ("engine=fake", "model.embedding_dim=8")
    sticky = "collect.policy=sticky"
    run(house, "pretrain", *small, sticky, "hydra.run.dir=networks")
    report = json.loads((house / "networks" / "report.json").read_text())
    # Ahead, left and right: after two, left-right and right-left end alike.
    assert report["l_bayes_bound"][:2] == pytest.approx([1, 8 / 9], abs=1e-6)
    assert 0 < report["mazes"]["select"]["useful_uniform_1"] < 1
    assert (house / "networks" / "report.png").stat().st_size > 10_000

    small = (*small, "policy.view_size=36", "policy.hidden=16")
    run(house, "explore", *small, "pretrained=networks", "hydra.run.dir=run")
    judged = rows(house / "run" / "evaluation.csv")
    assert all(0 < float(row["coverage"]) <= 1 for row in judged)
    assert (house / "run" / "map.png").stat().st_size > 5_000

    # Pictures of the goals on a walk of the frontier expert, and the path oracle.
    walk = ("goals.source=walk", "evaluate.policies=[navigator,oracle]")
    run(house, "navigate", "run=run", *walk, "hydra.run.dir=navigated")
    players = {row["policy"] for row in rows(house / "navigated" / "episodes.csv")}
    assert players == {"navigator", "oracle"}

    run(house, "tour", "engine=fake", "hydra.run.dir=tour")
    assert (house / "tour" / "walk.mp4").stat().st_size > 3_000
