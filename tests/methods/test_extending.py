"""A reward method and a learner are added as docs/extending.md says, and run."""

import csv
import json
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
    paid = [float(row["intrinsic_return"] or "nan") for row in rows[:4]]
    assert all(0 <= one <= 32 for one in paid)
    assert any(one > 0 for one in paid)
    # Nothing was pre-trained: this reward needs no networks.
    assert not (house / "runs" / "pretrain").exists()
    assert not (house / "run" / "networks.pt").exists()


#: Each command line in a fork of one process, which imports the house.
_REFUSED = """
import json, sys
from tests.forked import run_forked
for words in json.loads(sys.argv[1]):
    done = run_forked("explore", *words, "hydra.run.dir=refused")
    print(json.dumps([done.returncode, done.stderr]))
"""


@pytest.mark.slow
def test_their_settings_are_checked(house: Path) -> None:
    sentences = {
        ("reward=straight", "reward.alpha=1"): "'reward.alpha' must go with "
        "reward=novelty, got reward=straight",
        ("reward=straight", "reward.amount=0"): "reward.amount must be above 0, got",
        ("loss=reinforce", "loss.epochs=2"): "'loss.epochs' must go with loss=ppo, got "
        "loss=reinforce",
    }
    lines = json.dumps([[*SMOKE, *words] for words in sentences])
    done = subprocess.run(
        [sys.executable, "-c", _REFUSED, lines],
        cwd=house,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(house), str(ROOT)])},
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    ended = [json.loads(line) for line in done.stdout.splitlines()]
    for sentence, (status, said) in zip(sentences.values(), ended, strict=True):
        assert status == 2
        assert sentence in said
        assert len(said.strip().splitlines()) == 1
