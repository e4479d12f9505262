"""The row of an exploration, from the files that it left."""

import math
from pathlib import Path

import pytest

from tests.benchmarks.loading import load_benchmark
from tests.exploring import explore_settings

EVALUATION = """policy,coverage,decisions_to_90
last,0.9,400
last,0.7,-1
best,0.5,-1
random,0.4,-1
"""
MAP = """decisions,waypoints,cells,coverage,first_waypoint_share,last_waypoint_share,\
false_edges,false_paths,missing_edges,true_components,stretch,decisions_to_cover
1000,90,60,0.95,0.5,0.1,0.1,0.2,0.3,4,1.5,
2000,630,63,0.968254,0.05,0.001,0.01,0.02,0.03,2,1.05,1200
"""

PHASES = """phase,seconds
explore,90
evaluate and finish map and networks,120
"""


def test_a_row_is_of_the_last_map_and_of_the_policy_that_was_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = load_benchmark("main_rows", monkeypatch)
    settings = explore_settings("maze.episode_length=1800")
    monkeypatch.setattr(rows, "read_settings", lambda run: settings)
    monkeypatch.setattr(rows, "random_to_cover", lambda *given: 100 + given[-1])
    (tmp_path / "evaluation.csv").write_text(EVALUATION)
    (tmp_path / "map.csv").write_text(MAP)
    (tmp_path / "metrics.csv").write_text("decisions\n1000\n2000\n")
    (tmp_path / "phases.csv").write_text(f"{PHASES}pre-train,60\n")
    row = rows.read_run(tmp_path)
    # 61 of 63 cells have a waypoint.
    assert row["coverage"] == 0.9683
    assert row["waypoints_per_cell"] == 10.0
    assert row["decisions_to_cover"] == 1200
    # Seeds 0, 1 and 2.
    assert row["random_decisions_to_cover"] == 101
    # The mean of 0.9 and 0.7; and of 400 and 1,800, of the one that missed it.
    assert (row["kept"], row["kept_coverage"]) == ("last", 80.0)
    assert row["kept_decisions_to_90_or_end"] == 1100
    assert row["last_episodes_at_90"] == "1 of 2"
    assert (row["minutes_pretrain"], row["minutes_explore"]) == (1.0, 1.5)
    # Without pre-training and map, with a setting of its own.
    (tmp_path / "map.csv").unlink()
    (tmp_path / "phases.csv").write_text(PHASES)
    (tmp_path / "config").mkdir()
    (tmp_path / "config/config.yaml").write_text("loss:\n  name: ppo\n")
    shorter = rows.read_run(tmp_path, ["loss.name"])
    assert shorter["loss.name"] == "ppo"
    assert math.isnan(shorter["minutes_pretrain"])
    assert (shorter["minutes_explore"], shorter["minutes_finish"]) == (1.5, 2.0)
    assert shorter["kept_coverage"] == 80.0
    assert "stretch" not in shorter


def test_networks_are_named_after_the_maze_that_they_were_trained_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = load_benchmark("main_rows", monkeypatch)
    config = tmp_path / "config"
    config.mkdir()
    (config / "config.yaml").write_text("maze:\n  name: select\n  path: null\n")
    named = {
        "pretrained=null": None,
        "pretraining.maze=maze2": "maze2",
        f"pretrained={tmp_path}": "select",
        f"pretrained={tmp_path / 'networks.pt'}": "select",
        "pretrained=package:maze3": "maze3",
    }
    for given, name in named.items():
        assert rows.trained_in(explore_settings(given)) == name, given
