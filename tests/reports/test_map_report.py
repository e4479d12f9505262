import math
from pathlib import Path

import pytest

from tests.sweeps import make_exploration, write_table
from toponav.reports import report_maps
from toponav.runs import find_runs


def map_row(**changes: float) -> dict[str, object]:
    row = {
        "decisions": 400,
        "first_waypoint_share": 0.4,
        "last_waypoint_share": 0.1,
        "cells": 60,
        "waypoints": 120,
        "coverage": 1.0,
        "false_edges": 0.02,
        "false_paths": 0.5,
        "missing_edges": 0.25,
        "true_components": 3,
        "stretch": 1.5,
        "decisions_to_cover": 200.0,
    }
    return {**row, **changes}


def test_the_last_map_of_each_run_counts(tmp_path: Path) -> None:
    for seed, waypoints in enumerate((120, 180)):
        run = make_exploration(tmp_path, "maze=maze1", seed=seed, best=[0.9])
        write_table(
            run / "map.csv", [map_row(waypoints=6), map_row(waypoints=waypoints)]
        )
    other = make_exploration(tmp_path, "maze=maze2", best=[0.9])
    write_table(other / "map.csv", [map_row(decisions_to_cover=math.nan)])
    without = make_exploration(tmp_path, "maze=maze3", best=[0.9])

    scores, left_out = report_maps(find_runs(tmp_path))
    lacking = "some of its values are missing or no finite numbers"
    assert left_out == [
        f"{without} is left out: it has no map.csv",
        f"decisions to cover of last map (maze=maze2) is left out: {lacking}",
    ]
    found = {(one.settings["maze"], one.measure): one.values for one in scores}
    # 120 and 180 waypoints in 60 cells.
    assert found["maze1", "waypoints in a cell"].tolist() == [2.0, 3.0]
    assert found["maze1", "missing edges (%)"].tolist() == [25.0, 25.0]
    assert found["maze1", "decisions to cover"].tolist() == [200.0, 200.0]
    assert found["maze2", "last tenth of the views: waypoints (%)"].tolist() == [
        pytest.approx(10.0)
    ]
    # It never covered the maze.
    assert ("maze2", "decisions to cover") not in found


def test_those_that_cover_do_not_stand_for_those_that_never_did(tmp_path: Path) -> None:
    for seed, decisions in enumerate((200.0, math.nan)):
        run = make_exploration(tmp_path, seed=seed, best=[0.9])
        write_table(run / "map.csv", [map_row(decisions_to_cover=decisions)])
    scores, left_out = report_maps(find_runs(tmp_path))
    measures = [one.measure for one in scores]
    assert len(measures) == 9
    assert "decisions to cover" not in measures
    assert [said.partition(" of ")[0] for said in left_out] == ["decisions to cover"]


def test_the_map_of_a_run_that_is_not_over_does_not_count(tmp_path: Path) -> None:
    for seed, waypoints in enumerate((120, 6)):
        run = make_exploration(tmp_path, "maze=maze1", seed=seed, best=[0.9])
        write_table(run / "map.csv", [map_row(waypoints=waypoints)])
    (run / "evaluation.csv").unlink()
    scores, left_out = report_maps(find_runs(tmp_path))
    assert left_out == [f"{run} is left out: it has no evaluation.csv"]
    found = {one.measure: one.values.tolist() for one in scores}
    assert found["waypoints in a cell"] == [2.0]


def test_places_of_other_runs_make_no_groups(tmp_path: Path) -> None:
    for seed in (0, 1):
        words = (
            f"pretraining.folder=/somewhere/{seed}",
            f"evaluate.random_folder={seed}",
        )
        run = make_exploration(tmp_path, *words, seed=seed, best=[0.9])
        write_table(run / "map.csv", [map_row()])
    scores, _ = report_maps(find_runs(tmp_path))
    assert all(len(one.values) == 2 for one in scores)
