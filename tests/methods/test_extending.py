"""A reward method and a learner are added as docs/extending.md says, and run."""

import csv
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
GUIDE = ROOT / "docs" / "extending.md"
SMOKE = ("scale=smoke", "policy.hidden=16", "collect.decisions=512")


def blocks() -> dict[str, str]:
    """The guide's blocks that are whole files, by their paths."""
    found = re.findall(
        r"^```(?:python|yaml)\n# (\S+/\S+)\n(.*?)^```$",
        GUIDE.read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    )
    return dict(found)


def add_method(house: Path, kind: str, group: str, name: str, class_name: str) -> None:
    """Add one method as the guide has it, and its line in the registry."""
    methods = house / "toponav" / "methods" / kind
    for path in (f"toponav/methods/{kind}/{name}.py", f"conf/{group}/{name}.yaml"):
        (house / path).write_text(blocks()[path], encoding="utf-8")
    face = methods / "__init__.py"
    text = face.read_text(encoding="utf-8")
    registry = re.compile(rf"^{kind.upper()}\b.* = {{$", re.MULTILINE)
    line = f"from toponav.methods.{kind}.{name} import {class_name}\n"
    first = text.index("from toponav")
    text, added = registry.subn(
        rf'\g<0>"{name}": {class_name},', text[:first] + line + text[first:]
    )
    assert added == 1
    face.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project with both toys in it."""
    house = tmp_path_factory.mktemp("house")
    for folder in ("toponav", "conf", "recipes"):
        shutil.copytree(ROOT / folder, house / folder)
    add_method(house, "rewards", "reward", "straight", "StraightMethod")
    add_method(house, "learners", "loss", "reinforce", "ReinforceLearner")
    return house


def explore(house: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "recipes/explore.py", *SMOKE, *words]
    return subprocess.run(
        command,
        cwd=house,
        env={**os.environ, "PYTHONPATH": str(house)},
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )


@pytest.mark.slow
def test_both_run_through_the_recipe(house: Path) -> None:
    done = explore(house, "reward=straight", "loss=reinforce", "hydra.run.dir=run")
    assert done.returncode == 0, done.stderr
    with (house / "run" / "evaluation.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["policy"] for row in rows} == {"best", "last", "random", "sticky"}
    # 64 decisions that walk straight on are paid 0.5 each.
    assert all(0 <= float(row["intrinsic_return"]) <= 32 for row in rows)
    assert any(float(row["intrinsic_return"]) > 0 for row in rows)
    # Nothing was pre-trained: this reward needs no networks.
    assert not (house / "runs").exists()
    assert not (house / "run" / "networks.pt").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["reward=straight", "reward.alpha=1"],
            "'reward.alpha' must go with reward=novelty, got reward=straight",
        ),
        (["reward=straight", "reward.amount=0"], "reward.amount must be above 0, got"),
        (
            ["loss=reinforce", "loss.epochs=2"],
            "'loss.epochs' must go with loss=ppo, got loss=reinforce",
        ),
    ],
)
def test_their_settings_are_checked(
    house: Path, words: list[str], sentence: str
) -> None:
    done = explore(house, *words, "hydra.run.dir=refused")
    assert done.returncode == 2
    assert sentence in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
