"""The whole explore recipe in a foreign world without ground truth."""

import csv
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.exploring import explore_settings
from tests.forked import run_forked
from toponav.builders import load_networks
from toponav.builders.pretraining import pretraining_overrides
from toponav.graph import load_map

ROOT = Path(__file__).parent.parent
HAS_LAB, HAS_RAY = (find_spec(name) is not None for name in ("deepmind_lab", "ray"))
WORLD = ("world=gym", "world.id=tests.foreign_world:ForeignWorld-v0")


def test_smoke_shortens_the_episodes_of_any_world() -> None:
    config = explore_settings(*WORLD)
    assert config.world.episode_length == 64
    words = pretraining_overrides(config)
    assert "world.episode_length=64" in words
    assert not [word for word in words if word.startswith(("maze", "engine"))]


def explore(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "recipes/explore.py"), "scale=smoke", *words]
    return subprocess.run(
        command,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=290,
        check=False,
    )


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_it_pretrains_explores_and_maps_without_coverage(tmp_path: Path) -> None:
    where = "world.position=[_cell.0,_cell.1]"
    done = explore(*WORLD, where, "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "places visited per episode: best " in done.stdout
    assert "intrinsic return per episode: best " in done.stdout
    run = tmp_path / "run"
    # Pre-training: networks for four actions and views of this world's size.
    networks = load_networks(run)
    assert (networks.num_actions, networks.view_size) == (4, (48, 64))
    assert set(networks.thresholds) == {"tc_threshold", "tc_reach", "reward_threshold"}
    # Exploring: everything but coverage is in the tables.
    metrics, episodes = rows(run / "metrics.csv"), rows(run / "episodes.csv")
    assert [row["decisions"] for row in metrics] == ["256", "512", "768", "1024"]
    assert float(metrics[-1]["entropy"]) < 1.4  # log 4 is 1.39
    assert {"intrinsic_return", "new_waypoints", "waypoints"} <= set(episodes[0])
    policies = {row["policy"] for row in rows(run / "evaluation.csv")}
    assert policies == {"best", "last", "random", "sticky"}
    # The measure that this world allows: of 84 cells, in 64 decisions.
    for row in (*episodes, *rows(run / "evaluation.csv")):
        assert 1 <= int(row["places"]) <= 65
    # The map: a graph, drawn without a plan.
    drawn = rows(run / "map.csv")[-1]
    state, _ = load_map(run / "map.zip")
    assert int(drawn["waypoints"]) == len(state["embeddings"]) > 0
    assert int(drawn["components"]) >= 1
    for name in ("curves.png", "topology.png", "episode.mp4"):
        assert (run / name).stat().st_size > 3_000, name
    for table in ("metrics.csv", "episodes.csv", "evaluation.csv", "map.csv"):
        columns = rows(run / table)[0]
        assert not [name for name in columns if "cover" in name], table
    # What only poses can show is not there.
    assert not (run / "map.png").exists()
    assert not (run / "map_poses.npy").exists()
    # And walks to pictures, judged by the positions.
    done = run_forked("navigate", "run=run", "scale=smoke", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "sticky: came to the place of " in done.stdout
    (walks,) = (tmp_path / "runs/navigate").iterdir()
    walked = rows(walks / "episodes.csv")
    assert {row["policy"] for row in walked} == {"navigator", "random", "sticky"}
    assert all(-1 <= int(row["decisions"]) <= 64 for row in walked)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([*WORLD, "maze.apples=3"], "'maze.apples' must go with world=maze, got world"),
        ([*WORLD, "reward=coverage"], "reward=coverage must be used in a world that"),
        (["world=gym", "world.id=NoSuchWorld-v0"], "world.id: "),
        (["world=gym", "world.id=CartPole-v1"], "world.id: "),
        (["world=gym", "world.id=Pendulum-v1", "world.render=true"], "world.id: "),
        (["device=abacus"], "device must be auto, cpu or a GPU that this machine has"),
        (["ray.address=localhost:1"], "ray.address must go with collect.backend=ray"),
        ([*WORLD, "world.wrappers=[no.such.Wrapper]"], "world.id: wrappers must be "),
        ([*WORLD, "world.options=[max_steps]"], "world.options must hold entries"),
        (["world=gim"], "world must be one of gym, maze, got 'gim'"),
        pytest.param(
            ["engine=dmlab", "maze=maze1"],
            "the DeepMind Lab engine must be installed, and there is no Python",
            marks=pytest.mark.skipif(HAS_LAB, reason="it is installed"),
        ),
        pytest.param(
            ["hydra/launcher=ray"],
            "got 'ray', which comes with pip install 'toponav[ray-sweeps]'",
            marks=pytest.mark.skipif(HAS_RAY, reason="its launcher may be there"),
        ),
        (
            ["collect.backend=ray", "ray.address=localhost:1"],
            "ray.address must"
            if HAS_RAY
            else "collect.backend=ray must have Ray, which",
        ),
    ],
)
def test_what_does_not_fit_is_one_sentence(
    words: list[str], sentence: str, tmp_path: Path
) -> None:
    words = ["scale=smoke", *words, "hydra.run.dir=run"]
    done = run_forked("explore", *words, cwd=tmp_path)
    # What is not installed is no mistake in a setting.
    assert done.returncode == (1 if "engine=dmlab" in words else 2), done.stderr
    assert sentence in done.stderr
    # SDL, which draws Pendulum, says a line of its own where there is no screen.
    lines = [line for line in done.stderr.splitlines() if "XDG_RUNTIME" not in line]
    assert len(lines) == 1
    # Nothing started, so that nothing is left.
    assert not list(tmp_path.iterdir())
