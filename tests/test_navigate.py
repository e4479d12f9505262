"""The navigate recipe, run as its users run it."""

import csv
import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import pytest
from PIL import Image

from tests.explored import make_run, write_map
from tests.forked import run_forked

RECIPE = Path(__file__).parent.parent / "recipes" / "navigate.py"


def navigate(run: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    words = [f"run={run}", "scale=smoke", *overrides]
    return subprocess.run(
        [sys.executable, str(RECIPE), *words],
        cwd=run,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )


def play(run: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    """The same in a fork of this process."""
    words = [f"run={run}", "scale=smoke", *overrides]
    return run_forked("navigate", *words, cwd=run)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("explored") / "run"
    make_run(folder)
    return folder


@pytest.mark.slow
def test_a_sweep_over_closed_slots_leaves_tables_pictures_and_videos(run: Path) -> None:
    done = navigate(
        run,
        "maze.blocked=[],[a]",
        # Networks that were never trained get nowhere: it has to give up soon.
        "navigator.block_after=3",
        "hydra.sweep.dir=sweep",
        "hydra.sweep.subdir=${hydra.job.num}",
        "-m",
    )
    assert done.returncode == 0, done.stderr
    assert "ring, nothing closed" in done.stdout
    assert "ring, a closed" in done.stdout
    for number in ("0", "1"):
        folder = run / "sweep" / number
        episodes = rows(folder / "episodes.csv")
        names = ["navigator", "navigator", "oracle", "oracle", "random", "random"]
        assert [row["policy"] for row in episodes] == names
        summary = {row["policy"]: row for row in rows(folder / "summary.csv")}
        # A ring of eight cells: 60 decisions are several goals for who knows the way.
        assert float(summary["oracle"]["goals"]) >= 2
        assert summary["oracle"]["success_60"] == "1"
        assert float(summary["navigator"]["replans"]) > 0
        assert float(summary["random"]["replans"]) == 0
        shares = [
            float(value)
            for name, value in summary["navigator"].items()
            if name.startswith("decisions_")
        ]
        assert sum(shares) == pytest.approx(1, abs=1e-4)
        for name in ("success.png", "path.png"):
            assert min(Image.open(folder / name).size) > 300
        assert iio.imread(folder / "walk.mp4").shape[0] == 12
        assert (folder / "summary.md").read_text().startswith("ring, ")


@pytest.mark.slow
def test_a_navigator_by_poses_plays_where_the_map_has_them(tmp_path: Path) -> None:
    make_run(tmp_path, poses=True)
    done = navigate(
        tmp_path,
        "navigator=poses",
        "evaluate.policies=[navigator,perfect_controller,oracle]",
        "hydra.run.dir=out",
    )
    assert done.returncode == 0, done.stderr
    names = [row["policy"] for row in rows(tmp_path / "out" / "summary.csv")]
    assert names == ["navigator", "perfect_controller", "oracle"]
    assert min(Image.open(tmp_path / "out" / "path.png").size) > 300
    (tmp_path / "places.pt").unlink()
    refused = navigate(tmp_path, "navigator=poses", "hydra.run.dir=none")
    assert refused.returncode != 0
    assert "navigator=poses must be given a map with poses" in refused.stderr
    assert "Traceback" not in refused.stderr


@pytest.mark.slow
def test_by_edges_it_closes_what_it_does_not_get_over(run: Path) -> None:
    done = play(
        run,
        "maze.blocked=[a]",
        "navigator.block_on=edge",
        "navigator.block_after=3",
        "navigator.fade_after=null",
        "evaluate.policies=[navigator]",
        "video.decisions=0",
        "hydra.run.dir=edges",
    )
    assert done.returncode == 0, done.stderr
    (summary,) = rows(run / "edges" / "summary.csv")
    assert float(summary["replans"]) > 0


@pytest.mark.slow
def test_all_meet_the_same_episodes_and_a_seed_repeats_them(run: Path) -> None:
    def played(name: str, *overrides: str) -> list[dict[str, str]]:
        done = play(run, "video.decisions=0", f"hydra.run.dir={name}", *overrides)
        assert done.returncode == 0, done.stderr
        assert not (run / name / "walk.mp4").exists()
        return rows(run / name / "episodes.csv")

    first = played("first")
    alone = played("alone", "evaluate.policies=[oracle]")
    assert [row for row in first if row["policy"] == "oracle"] == alone
    again = played("again", "evaluate.policies=[navigator]", "goals.source=map")
    assert [row for row in first if row["policy"] == "navigator"] == again


@pytest.mark.slow
def test_goals_are_played_where_there_are_pictures(tmp_path: Path) -> None:
    config = make_run(tmp_path)
    write_map(tmp_path, config, cells=3)
    done = play(tmp_path, "video.decisions=0", "hydra.run.dir=few")
    assert done.returncode == 0, done.stderr
    assert "| places_without_picture | 4 " in done.stdout
    summary = rows(tmp_path / "few" / "summary.csv")
    assert [row["places_without_picture"] for row in summary] == ["4"] * 3
    assert float(summary[1]["goals"]) > 0


@pytest.mark.slow
def test_pictures_of_a_walk_that_the_map_has_not_seen(run: Path) -> None:
    done = play(
        run,
        "goals.source=walk",
        "evaluate.policies=[navigator]",
        "evaluate.episodes=1",
        "navigator.tc_reach=0.9999",
        "hydra.run.dir=walk",
    )
    assert done.returncode == 0, done.stderr
    assert "navigate" not in done.stderr.splitlines()[-1]
    assert "a goal's pictures must be like a waypoint" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (
            ["maze=maze1"],
            "navigate: maze must be the one that the run explored, got maze1 (did you "
            "mean maze=run?)",
        ),
        (
            ["maze.blocked=[z]"],
            "navigate: maze: blocked slots must be slots of ring (a), got 'z'",
        ),
        (
            ["run=null"],
            "navigate: run must name the folder of an exploration, got none",
        ),
        (
            ["navigator.patience=3"],
            "navigate: 'navigator.patience' must be a setting of navigate, got none of "
            "that name (did you mean 'navigator.goal_patience'?)",
        ),
        (
            ["navigator=random", "navigator.temperature=0.3"],
            "navigate: 'navigator.temperature' must go with navigator=topological or "
            "navigator=poses, got navigator=random",
        ),
    ],
)
def test_a_bad_setting_is_one_sentence(
    run: Path, overrides: list[str], sentence: str
) -> None:
    done = play(run, *overrides)
    assert done.stderr.strip().splitlines()[-1] == sentence
    assert done.returncode == 2
