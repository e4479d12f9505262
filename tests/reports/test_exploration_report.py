"""What a run shows while it explores, before an episode has ended."""

import csv
from pathlib import Path
from unittest.mock import Mock

import pytest

from tests.exploring import explore_settings, world_of
from tests.training.test_map_growth import make_growth, make_walk, settings
from toponav.methods import make_reward
from toponav.reports import ExplorationReport, Schedule
from toponav.reports.exploration_evaluation import make_plan
from toponav.reports.schedule import EVALUATE, EXPLORE
from toponav.training import EpisodeLog, ExplorationState


def test_all_pictures_come_with_the_first_row_and_no_episode_has_to_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # A batch of 4 x 32 decisions, a row every 100; episodes have 64.
    config = settings("report.every=100", "collect.decisions=1000")
    world = world_of(config)
    growth = make_growth(config, tmp_path)
    log = EpisodeLog(4, world, make_reward(config, world, None))
    state = ExplorationState()
    schedule = Schedule({EXPLORE: 60.0, EVALUATE: 30.0}, tmp_path)
    consumers = {"map": growth, "log": log}
    report = ExplorationReport(
        config, world, tmp_path, state, log, consumers, schedule, Mock(levels=dict)
    )
    batch = make_walk(config)
    state.count(batch.numel(), 1.0, config.collect)
    measured = {**growth.extend(batch), **log.extend(batch)}
    report.update(measured, batch.numel())
    growth.writer.wait()
    report.close()
    assert log.rows == []
    for name in ("curves.png", "map.png", "topology.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG"), name
    with (tmp_path / "metrics.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert float(row["decisions"]) == 128
    assert 0 < float(row["running_coverage"]) < 1
    assert float(row["running_waypoints"]) == 5
    said = capsys.readouterr().err
    assert "running coverage" in said
    assert (
        "phase 1 of 2: explore, then evaluate and finish map and networks; all" in said
    )


def test_a_closed_slot_is_closed_on_the_plan_and_no_floor() -> None:
    shut = make_plan(world_of(explore_settings("maze=maze1", "maze.blocked=[a]")))
    open_ = make_plan(world_of(explore_settings("maze=maze1")))
    assert (list(shut.closed), list(open_.closed)) == (["a"], [])
    assert set(shut.slots) == set(open_.slots) == {"a", "b"}
    assert (shut.floor.sum(), open_.floor.sum()) == (50, 51)
    assert not shut.floor[shut.slots["a"]]
