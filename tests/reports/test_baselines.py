import json
import math
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import psutil
import pytest
import torch

from tests.exploring import explore_settings, world_of
from toponav.builders import World, make_networks
from toponav.config import ExploreConfig, SettingsError
from toponav.envs.engines.doom import instances
from toponav.methods import make_reward, make_world
from toponav.methods.worlds.maze import MazeWorld
from toponav.reports import (
    Baselines,
    baselines,
    evaluate_policies,
    start_baselines,
)
from toponav.training import ExplorationState, Explorer, Row, make_learner

#: What is played is made up: the coverage of each episode.
PLAYED: list[Row] = [
    {"policy": name, "seed": number, "coverage": coverage}
    for name, both in (("random", (0.25, 0.5)), ("sticky", (0.5, 1.0)))
    for number, coverage in enumerate(both)
]


@pytest.fixture
def config(tmp_path: Path) -> ExploreConfig:
    return explore_settings(f"evaluate.random_folder={tmp_path}/kept")


@pytest.fixture
def plays(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The mazes that were played, without an engine."""
    found: list[str] = []

    def play(_: ExploreConfig, world: World) -> tuple[list[Row], bool]:
        found.append(world.name)
        return PLAYED, True

    monkeypatch.setattr(baselines, "_play", play)
    return found


def rows_of(config: ExploreConfig) -> list[Row]:
    return rows_from(start_baselines(config, world_of(config)))


def rows_from(started: Baselines) -> list[Row]:
    """In mazes, whoever explores does not matter."""
    return started.rows(started.settings, Mock())


def test_they_are_played_once_for_all_seeds_of_exploration(
    config: ExploreConfig, plays: list[str]
) -> None:
    assert start_baselines(config, world_of(config)).levels() == {}
    for seed in range(3):
        assert rows_of(replace(config, seed=seed)) == PLAYED
    assert plays == ["maze3"]
    levels = start_baselines(config, world_of(config)).levels()
    assert levels == {"random": 0.375, "sticky": 0.75}


def test_their_file_is_that_of_what_they_depend_on(tmp_path: Path) -> None:
    def file_of(*words: str) -> Path:
        config = explore_settings(*words)
        return baselines.baselines_file(config, world_of(config))

    same = ("seed=3", "reward=rnd", "loss.lr=0.01", "evaluate.episodes=5")
    for word in (*same, "maze.texture_seed=1", "maze.paintings=0", "maze.marks=0"):
        assert file_of(word) == file_of(), word
    others = ["maze=maze1", "evaluate.random_seed=1", "evaluate.random_episodes=3"]
    others += ["maze.episode_length=65", "maze.goal=true", "maze.apples=1"]
    files = {file_of(word) for word in others} | {file_of()}
    files.add(file_of("maze=maze1", "maze.blocked=[a]"))
    assert len(files) == len(others) + 2
    # A layout of one's own counts by its text.
    found = set()
    for text in ("****\n*  *\n****\n", "*****\n*   *\n*****\n"):
        (tmp_path / "own.txt").write_text(text)
        found.add(file_of("maze=file", f"maze.path={tmp_path}/own.txt"))
    assert len(found) == 2


def test_half_a_file_of_a_killed_run_goes(
    config: ExploreConfig, plays: list[str]
) -> None:
    file = baselines.baselines_file(config, world_of(config))
    file.parent.mkdir(parents=True)
    half, other = (
        file.with_name(f".{stem}.4711.json") for stem in (file.stem, "maze9-abc")
    )
    half.touch()
    other.touch()  # of another maze, which somebody may be writing
    assert rows_of(config) == PLAYED
    assert not half.exists()
    assert other.exists()


@pytest.mark.parametrize(
    ("old", "new"),
    [('"rows"', '"row"'), ('"sticky"', '"stuck"'), ("0.5", "null"), ("1", "2")],
)
def test_a_damaged_file_is_made_again(
    config: ExploreConfig, plays: list[str], old: str, new: str
) -> None:
    rows_of(config)
    file = baselines.baselines_file(config, world_of(config))
    whole = file.read_text()
    deep = "[" * 100_000
    for damaged in (whole.replace(old, new), whole[: len(whole) // 2], "", deep):
        file.write_text(damaged)
        assert rows_of(config) == PLAYED
        assert file.read_text() == whole
    assert len(plays) == 5


def test_rows_of_other_columns_are_played_again(
    config: ExploreConfig, plays: list[str]
) -> None:
    rows_of(config)
    file = baselines.baselines_file(config, world_of(config))
    whole = file.read_text()
    # One name of a column with another letter, as in the last row, which names all.
    found = json.loads(whole)
    found["rows"][-1]["x"] = 1.0
    file.write_text(json.dumps(found))
    assert rows_of(config) == PLAYED
    assert file.read_text() == whole
    assert len(plays) == 2


def test_where_nothing_can_be_kept_is_said_before_a_run(
    config: ExploreConfig, plays: list[str], tmp_path: Path
) -> None:
    (tmp_path / "kept").write_text("a file, no folder")
    with pytest.raises(SettingsError) as error:
        start_baselines(config, world_of(config))
    assert str(error.value) == (
        "evaluate.random_folder must name a folder that can be written to, got "
        f"'{tmp_path}/kept' (Not a directory)"
    )
    # If that happens later, they are played anyway.
    for _ in range(2):
        assert rows_from(Baselines(config, world_of(config))) == PLAYED
    assert len(plays) == 2


def test_episodes_that_lost_their_engine_are_not_kept(
    config: ExploreConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(baselines, "_play", lambda *_: (PLAYED, False))
    assert rows_of(config) == PLAYED
    assert baselines.find_baselines(config, world_of(config)) is None


def test_of_two_runs_at_once_one_plays(
    config: ExploreConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    plays = []

    def play(*_: object) -> tuple[list[Row], bool]:
        plays.append(1)
        time.sleep(0.3)
        return PLAYED, True

    monkeypatch.setattr(baselines, "_play", play)
    found: list[list[Row]] = []
    threads = [
        threading.Thread(target=lambda: found.append(rows_of(config))) for _ in "1234"
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [PLAYED] * 4
    assert len(plays) == 1
    file = baselines.baselines_file(config, world_of(config))
    assert list(file.parent.iterdir()) == [file]  # no lock is left


def test_a_process_that_is_killed_costs_a_sentence(
    config: ExploreConfig,
    plays: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(baselines, "FEW", 0)
    started = start_baselines(config, world_of(config))
    assert started.beside is not None
    started.beside.process.kill()
    assert rows_from(started) == PLAYED
    assert plays == ["maze3"]
    said = capsys.readouterr().out.strip().splitlines()[-1]
    assert said == (
        "the blind baselines must be played beside the run, got: exit status -9; "
        "they are played now"
    )
    # What is there needs no process.
    assert start_baselines(config, world_of(config)).beside is None


def test_a_world_without_ground_truth_is_played_with_its_reward(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(baselines, "FEW", 0)
    config = explore_settings(
        "world=gym", "world.id=tests.foreign_world:ForeignWorld-v0", "reward=random"
    )
    world = world_of(config)
    started = start_baselines(config, world)
    assert started.beside is None
    assert started.levels() == {}
    reward = make_reward(config, world, None)
    learner = make_learner(config, world, reward, ExplorationState(), tmp_path)
    rows = started.rows(config, Explorer(learner.policy, reward, None))
    names = [row["policy"] for row in rows]
    assert names == ["random", "random", "sticky", "sticky"]
    assert all(math.isfinite(row["intrinsic_return"]) for row in rows)


@pytest.mark.slow
def test_they_are_what_they_would_be_with_views_and_reward(
    tmp_path: Path,
) -> None:
    words = ["maze.goal=true", "maze.apples=5", "maze.episode_length=200"]
    config = explore_settings(f"evaluate.random_folder={tmp_path}", *words)
    world = world_of(config)
    networks = make_networks(config.model, world.spec)
    networks.thresholds = {"reward_threshold": 0.5}
    reward = make_reward(config, world, networks)
    learner = make_learner(config, world, reward, ExplorationState(), tmp_path)
    explorer = Explorer(learner.policy, reward, networks)
    policies = baselines.make_baselines(world, seed=0)
    seen = evaluate_policies(config, world, explorer, policies)
    expected = [row for one in seen for row in one.rows()]
    found = rows_of(config)
    assert len(found) == len(expected) == 4
    for one, other in zip(found, expected, strict=True):
        assert math.isnan(one.pop("intrinsic_return"))
        assert math.isfinite(other.pop("intrinsic_return"))
        assert one == other
    assert len({row["coverage"] for row in found}) > 1


@pytest.mark.slow
def test_a_process_of_the_lowest_priority_plays_the_same(
    config: ExploreConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(baselines, "FEW", 0)
    here = rows_of(config)
    file = baselines.baselines_file(config, world_of(config))
    file.unlink()
    threads = torch.get_num_threads()
    started = start_baselines(config, world_of(config))
    assert started.beside is not None
    deadline = time.monotonic() + 60
    while os.getpriority(os.PRIO_PROCESS, started.beside.process.pid) != 19:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    monkeypatch.setattr(baselines, "play_baselines", None)  # not here, then
    beside = rows_from(started)
    assert [{**row, "intrinsic_return": 0} for row in beside] == [
        {**row, "intrinsic_return": 0} for row in here
    ]
    assert torch.get_num_threads() == threads


@pytest.mark.slow
def test_the_reason_of_one_that_fails_is_said(
    config: ExploreConfig,
    plays: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(baselines, "FEW", 0)
    world = make_world(config)
    assert isinstance(world, MazeWorld)
    world.engine = "none"
    assert rows_from(start_baselines(config, world)) == PLAYED
    said = capsys.readouterr().out.strip().splitlines()[-1]
    assert "got: engine must be one of dmlab, vizdoom, got 'none'" in said


#: A run that has started its baselines and then waits.
RUN = """
import sys, time
from tests.exploring import explore_settings, world_of
from toponav.reports import start_baselines
words = ["maze.episode_length=100000", "evaluate.random_folder=" + sys.argv[1]]
config = explore_settings(*words)
started = start_baselines(config, world_of(config))
print(started.beside.process.pid, flush=True)
time.sleep(600)
"""


@pytest.mark.slow
def test_it_ends_with_a_run_that_is_killed(tmp_path: Path) -> None:
    run = subprocess.Popen(
        [sys.executable, "-c", RUN, str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert run.stdout is not None
        beside = psutil.Process(int(run.stdout.readline()))
        deadline = time.monotonic() + 300  # it runs at the lowest priority
        while not beside.children():  # engines
            assert beside.is_running()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        engines = beside.children()
    finally:
        run.kill()
        run.communicate()
    gone, _ = psutil.wait_procs([beside], timeout=60)
    assert gone
    # An engine that was still starting does not notice; the next start ends it.
    instances.sweep()
    _, left = psutil.wait_procs(engines, timeout=30)
    for process in left:
        process.kill()
    assert not left


def test_it_ends_when_nobody_wants_it_any_more(
    config: ExploreConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(baselines, "FEW", 0)
    started: Baselines = start_baselines(config, world_of(config))
    assert started.beside is not None
    process = started.beside.process
    del started
    assert process.returncode is not None
