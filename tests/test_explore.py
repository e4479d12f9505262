"""The explore recipe, run as its users run it."""

import contextlib
import csv
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import psutil
import pytest
import torch

from tests.composed import settings
from tests.exploring import explore_settings, make_policy, save_untrained
from tests.forked import run_forked
from toponav import reports
from toponav.builders import load_networks
from toponav.config import SettingsError
from toponav.experiments.found_runs import is_finished
from toponav.graph import load_map

RECIPE = Path(__file__).parent.parent / "recipes" / "explore.py"
SMOKE = ("scale=smoke", "model.embedding_dim=8", "policy.hidden=16")
#: Where episodes need not be many or long.
SHORT = (
    *("maze.episode_length=32", "collect.envs=2"),
    *("evaluate.episodes=1", "evaluate.random_episodes=1"),
)


def command(*overrides: str) -> list[str]:
    kept = f"evaluate.random_folder={tempfile.gettempdir()}/baselines"
    return [sys.executable, str(RECIPE), *SMOKE, kept, *overrides]


def explore(*overrides: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*overrides), capture_output=True, text=True, timeout=280, check=False
    )


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def leaves(value: object, name: str = "") -> dict[str, object]:
    """Tensors and plain values of nested containers, by their paths."""
    if isinstance(value, dict | list | tuple):
        pairs = value.items() if isinstance(value, dict) else enumerate(value)
        parts = [leaves(one, f"{name}/{key}") for key, one in pairs]
        return {path: leaf for part in parts for path, leaf in part.items()}
    return {name: value}


def require_same(one: object, other: object) -> None:
    first, second = leaves(one), leaves(other)
    assert first.keys() == second.keys()
    for name, value in first.items():
        if isinstance(value, torch.Tensor):
            torch.testing.assert_close(
                value, second[name], rtol=0, atol=0, equal_nan=True, msg=name
            )
        else:
            assert value == second[name], name


def without_times(path: Path) -> list[dict[str, str]]:
    """Rows without what no two runs share."""
    times = ("seconds", "decisions_per_second")
    return [{k: v for k, v in row.items() if k not in times} for row in rows(path)]


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("networks") / "networks.pt"
    save_untrained(path)
    return path


@pytest.fixture(scope="module")
def run(networks: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole run."""
    folder = tmp_path_factory.mktemp("run") / "maze3"
    done = explore(f"pretrained={networks}", f"hydra.run.dir={folder}")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("maze3: best policy covers ")
    assert "; random covers " in done.stdout
    last = done.stdout.splitlines()[-1]
    found = re.fullmatch(
        r"1,024 decisions in (.+) minutes of exploring; this command took (.+) minutes "
        rf"from start to end; written to {folder}",
        last,
    )
    assert found
    assert float(found[1]) <= float(found[2])
    assert "coverage " in done.stderr
    assert "waypoints " in done.stderr
    phase = "phase 1 of 2: explore, then evaluate and finish map and networks; all done"
    assert phase in done.stderr
    took = {row["phase"]: float(row["seconds"]) for row in rows(folder / "phases.csv")}
    assert list(took) == ["explore", "evaluate and finish map and networks"]
    assert all(seconds > 0 for seconds in took.values())
    return folder


@pytest.mark.slow
def test_it_leaves_tables_pictures_and_policies(run: Path) -> None:
    metrics = rows(run / "metrics.csv")
    assert [row["decisions"] for row in metrics] == ["256", "512", "768", "1024"]
    assert metrics[-1]["lr"] == "0"
    assert float(metrics[-1]["entropy"]) < 1.8
    # 4 mazes of 256 decisions each; cut at 16, 32, 48, 64, then whole: 3 each.
    assert len(rows(run / "episodes.csv")) == 13
    assert all(0 < float(row["coverage"]) < 1 for row in rows(run / "episodes.csv"))
    judged = rows(run / "evaluation.csv")
    first, second = (judged[number]["policy"] for number in (0, 2))
    names = [first, second, "random", "sticky"]
    assert {first, second} == {"best", "last"}
    assert [row["policy"] for row in judged] == [name for name in names for _ in "12"]
    # The better paid comes first, and is kept.
    paid = [float(row["intrinsic_return"]) for row in judged[:4]]
    assert sum(paid[:2]) >= sum(paid[2:])
    # Who sees nothing is judged by coverage alone.
    assert not any(row["intrinsic_return"] for row in judged[4:])
    assert all(0 < float(row["coverage"]) <= 1 for row in judged)
    for name in ("curves.png", "map.png", "episode.mp4"):
        assert (run / name).stat().st_size > 5_000, name
    assert list((run / "logs/tensorboard").iterdir())
    assert load_networks(run).thresholds["reward_threshold"] == 0.5
    topological_map = rows(run / "map.csv")[-1]
    state, about = load_map(run / "map.zip")
    assert len(state["edges"]) == int(topological_map["edges"])
    assert np.load(run / "map_poses.npy").shape == (
        int(topological_map["waypoints"]),
        3,
    )
    assert 0 < float(topological_map["coverage"]) <= 1
    assert about["maze"] == "maze3"
    assert (run / "topology.png").stat().st_size > 5_000
    policy = make_policy(explore_settings())
    policy.load_state_dict(torch.load(run / "policy.pt")["weights"])


def killed_and_resumed(networks: Path, folder: Path, *words: str) -> None:
    """A run that is killed after its first batches, and ends without its networks."""
    words = (f"pretrained={networks}", "report.save_every_s=0.01", *words)
    process = subprocess.Popen(
        command(*words, f"hydra.run.dir='{folder}'"),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + 200
        while not (folder / "metrics.csv").exists():
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert len(without_times(folder / "metrics.csv")) < 4
    networks.rename(networks.with_name("moved.pt"))
    try:
        done = explore(f"resume={folder}")
    finally:
        networks.with_name("moved.pt").rename(networks)
    assert done.returncode == 0, done.stderr


def require_same_runs(run: Path, folder: Path) -> None:
    for name in ("metrics", "episodes", "evaluation", "locomotion"):
        whole, cut = (without_times(one / f"{name}.csv") for one in (run, folder))
        assert whole == cut, name
    # Rows of the map are written by the clock.
    whole, cut = (without_times(one / "map.csv")[-1] for one in (run, folder))
    assert whole == cut
    for name in ("policy.pt", "networks.pt"):
        whole, cut = (
            torch.load(one / name, weights_only=True) for one in (run, folder)
        )
        require_same(whole, cut)
    require_same(load_map(run / "map.zip"), load_map(folder / "map.zip"))
    poses = (np.load(one / "map_poses.npy") for one in (run, folder))
    np.testing.assert_array_equal(*poses)
    # What is logged a row at a time, too.
    logs = [sorted((one / "logs/csv/scalars").rglob("*.csv")) for one in (run, folder)]
    for one, other in zip(*logs, strict=True):
        if "second" not in one.name:
            assert one.read_text() == other.read_text(), one.name


@pytest.mark.slow
def test_a_run_that_was_killed_ends_as_if_it_had_not_been(
    run: Path, networks: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "maze=maze3,seed=0"  # as a sweep names folders
    killed_and_resumed(networks, folder)
    require_same_runs(run, folder)


@pytest.mark.slow
def test_one_of_two_processes_that_was_killed_does_so_too(
    networks: Path, tmp_path: Path
) -> None:
    words = ("collect.workers=2", "collect.envs=4", "evaluate.episodes=1")
    folder = tmp_path / "whole"
    done = explore(f"pretrained={networks}", *words, f"hydra.run.dir={folder}")
    assert done.returncode == 0, done.stderr
    killed_and_resumed(networks, tmp_path / "cut", *words)
    require_same_runs(folder, tmp_path / "cut")


@pytest.mark.slow
def test_a_run_that_is_over_goes_on_with_more_decisions(
    run: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    words = ("collect.decisions=1280", "evaluate.episodes=1", "locomotion.updates=3")
    done = explore(f"resume={folder}", *words)
    assert done.returncode == 0, done.stderr
    metrics = rows(folder / "metrics.csv")
    assert [row["decisions"] for row in metrics][-2:] == ["1024", "1280"]
    assert rows(folder / "episodes.csv")[:13] == rows(run / "episodes.csv")
    state = torch.load(folder / "checkpoint.pt", weights_only=True)["state"]
    assert (state["decisions"], state["progress"]) == (1280, 1.0)


@pytest.mark.slow
def test_one_that_ends_before_it_is_evaluated_again_has_no_results(
    run: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    assert is_finished(folder)
    cut_off = patch.object(reports, "evaluating", side_effect=KeyboardInterrupt)
    words = (f"resume={folder}", "collect.decisions=1280")
    done = run_forked("explore", *words, inside=cut_off)
    assert done.returncode == 128 + signal.SIGINT, done.stderr
    assert rows(folder / "metrics.csv")[-1]["decisions"] == "1280"
    # Those that it had are of fewer decisions.
    assert not is_finished(folder)
    assert not (folder / "evaluation.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["async", "sync"])
@pytest.mark.parametrize("while_it_starts", [True, False])
def test_a_worker_that_dies_ends_the_run_with_a_checkpoint(
    networks: Path, tmp_path: Path, while_it_starts: bool, mode: str
) -> None:
    folder = tmp_path / "run"
    process = subprocess.Popen(
        command(
            f"pretrained={networks}",
            *SHORT,
            f"collect.mode={mode}",
            "collect.workers=2",
            "collect.decisions=1000000",
            # A run that can keep its episodes has what it last saved, with them; others
            # are saved when they end.
            f"report.save_every_s={1000 if mode == 'async' else 0.01}",
            f"hydra.run.dir='{folder}'",
        ),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )

    def workers() -> list[psutil.Process]:
        found = []
        for child in psutil.Process(process.pid).children():
            with contextlib.suppress(psutil.Error):  # it has ended
                if any("spawn_main" in word for word in child.cmdline()):
                    found.append(child)
        return found

    def saved() -> dict[str, Any]:
        found: dict[str, Any] = torch.load(folder / "checkpoint.pt", weights_only=True)
        return found

    def explores() -> bool:
        if not (folder / "metrics.csv").exists():
            return False
        return mode == "async" or saved()["state"]["decisions"] >= 256

    try:
        deadline = time.monotonic() + 200
        while not (workers() if while_it_starts else explores()):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
        workers()[-1].kill()
        _, entries = process.communicate(timeout=100)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 1
    assert "Traceback" not in entries
    sentence = entries.strip().splitlines()[-1]
    assert sentence.startswith(
        "explore: the collecting processes must live as long as the run, got: "
    )
    checkpoint = saved()
    assert checkpoint["state"]["decisions"] >= (0 if while_it_starts else 256)
    if not while_it_starts:
        assert ("episodes" in checkpoint) == (mode == "sync")


@pytest.mark.slow
def test_a_sweep_with_a3c_on_pixels_and_networks_that_learn(
    networks: Path, tmp_path: Path
) -> None:
    done = explore(
        "seed=1",
        f"pretrained={networks}",
        "policy.input=pixels",
        "loss=a3c",
        "loss.rollout=16",
        "reward.threshold=tc",
        "online.learn=true",
        "collect.workers=2",
        "evaluate.episodes=1",
        "evaluate.random_episodes=1",
        "locomotion.updates=3",
        f"hydra.sweep.dir={tmp_path}/sweep",
        "hydra.sweep.subdir=${seed}",
        "-m",
    )
    assert done.returncode == 0, done.stderr
    metrics = rows(tmp_path / "sweep/1/metrics.csv")
    versions = [row["networks_version"] for row in metrics]
    assert versions[0] == "0"
    assert versions[-1] in ("1", "2")
    assert float(metrics[-1]["loss_tc"]) > 0


@pytest.mark.slow
def test_a_sweep_over_seeds_shares_a_pretraining_and_the_baselines(
    tmp_path: Path,
) -> None:
    done = explore(
        *SHORT,
        f"pretraining.folder={tmp_path}/pretrain",
        f"evaluate.random_folder={tmp_path}/random",
        f"hydra.sweep.dir={tmp_path}/sweep",
        "hydra.sweep.subdir=${seed}",
        "seed=0,1",
        "-m",
    )
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "pretrain").rglob("networks.pt"))) == 1
    assert done.stdout.count("decisions, 20 updates in ") == 1
    assert len(list((tmp_path / "random").glob("*.json"))) == 1
    tables = [rows(tmp_path / "sweep" / seed / "evaluation.csv") for seed in "01"]
    blind = [[row for row in one if row["policy"] == "random"] for one in tables]
    assert blind[0] == blind[1] != []


@pytest.mark.slow
def test_a_loss_that_explodes_stops_the_run(networks: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    words = (*SMOKE, *SHORT, f"pretrained={networks}", "loss.lr=1e30")
    done = run_forked("explore", *words, f"hydra.run.dir={folder}")
    assert done.returncode == 1
    sentence = done.stderr.strip().splitlines()[-1]
    assert sentence.startswith("explore: ")
    assert "must be finite, got" in sentence
    assert "a smaller loss.lr may help" in sentence
    assert "Traceback" not in done.stderr
    state = torch.load(folder / "checkpoint.pt", weights_only=True)
    assert all(
        value.isfinite().all()
        for value in state["consumers"]["learner"]["policy"].values()
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("reward.alpah=0.2", "(did you mean 'reward.alpha'?)"),
        ("reward.clip=1", "(did you mean 'reward.alpha'?)"),
        ("maze=maze9", "got 'maze9' (did you mean 'maze"),
        ("reward=rdn", "got 'rdn' (did you mean 'rnd'?)"),
        ("engine=vizdom", "engine must be one of"),
        ("+reward.foo=1", "'reward.foo' must be a setting of explore, got none"),
        ("=3", "a setting must have a name before its equals sign, got '=3'"),
        ("--foo", "what begins with a dash must be a flag of Hydra's"),
        (
            "policy.view_size=100000000",
            "fit into this machine's memory and disk (smaller with smaller "
            "collect.envs and policy.view_size)",
        ),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(
    tmp_path: Path, override: str, sentence: str
) -> None:
    # What is accepted by mistake should end soon.
    quick = [] if override.startswith("reward") else ["reward=random"]
    words = [*SMOKE, override, *quick, f"hydra.run.dir={tmp_path}/run"]
    done = run_forked("explore", *words)
    assert done.returncode == (1 if "view_size" in override else 2)
    assert sentence in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("reward.alpha=2", r"reward.alpha must lie in .0, 1., got 2 \(did you mean 1"),
        ("reward.beta=-1", "reward.beta must be at least 0, got -1"),
        ("reward.threshold=high", r"one of auto, tc or a number in \[0, 0.999\]"),
        ("reward.threshold=1.5", r"or a number in \[0, 0.999\], got 1.5"),
        ("policy.input=smell", "policy.input must be one of auto, embedding, pixels"),
        ("collect.workers=0", "collect.workers must be at least 1, got 0"),
        ("collect.workers=3", r"collect.workers=3, got 4 \(did you mean 3\?\)"),
        ("collect.decisions=64", "one batch, got 64"),
        ("maze.episode_length=12", "more than M . k = 12 decisions, got 12"),
        ("online.every=0", "online.every must be at least 1, got 0"),
        ("map.edges=all", "map.edges must be one of both, reach, time, got"),
        ("map.extend_by=none", "map.extend_by must be one of itself, previous"),
        ("map.tc_threshold=high", r"map.tc_threshold must be one of auto or a number"),
        ("map.tc_reach=1.5", r"auto or a number in \[0, 0.999\], got 1.5"),
        (
            "map.window=-1",
            r"map.window must lie in \[0, 8192\], got -1 \(did you mean 0",
        ),
        (
            "map.surroundings=9000",
            r"lie in \[0, 8192\], got 9000 \(did you mean 8192\?",
        ),
        ("map.search_window=9000", r"map.search_window must lie in \[0, 8192\], got 9"),
        ("map.nearby=0", "map.nearby must be at least 1, got 0"),
        (
            "map.untraversed_edge_cost=0",
            "map.untraversed_edge_cost must be at least 1, got 0",
        ),
        ("map.sparsify=2", r"map.sparsify must lie in \[0, 1\], got 2"),
    ],
)
def test_a_value_out_of_range_is_refused(override: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        settings("explore", *SMOKE, override)


def test_a_beta_that_is_not_given_makes_the_weights_add_up_to_one() -> None:
    assert explore_settings("reward.alpha=0.25").reward.weights == (0.25, 0.75)
    words = ("reward.alpha=0.25", "reward.beta=0.5")
    assert explore_settings(*words).reward.weights == (0.25, 0.5)
