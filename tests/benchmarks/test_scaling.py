"""Exploration, map and navigation of a small maze, as the benchmark makes them."""

import shutil
from pathlib import Path

import pandas as pd
import pytest
from PIL import Image

from tests.benchmarks.loading import load_benchmark

SMALL = ("scale=smoke", "model.embedding_dim=8", "policy.hidden=16")


@pytest.mark.slow
def test_a_small_maze_is_explored_mapped_and_navigated_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scaling = load_benchmark("scaling", monkeypatch)
    table, figure = tmp_path / "scaling.csv", tmp_path / "scaling.png"
    words = ["scaling.py", "--sizes", "2x2", "--work", str(tmp_path / "runs")]
    words += ["--out", str(table), "--figure", str(figure)]
    words += ["--navigate", "scale=smoke", "--", *SMALL]
    monkeypatch.setattr("sys.argv", words)
    scaling.main()
    (row,) = pd.read_csv(table).to_dict("records")
    # 5 by 5 cells, of which 9 at most are open: four rooms and what joins them.
    assert row["area"] == 25
    assert 7 <= row["cells"] <= 9
    assert row["episode_length"] == round(1_800 / 63 * row["cells"])
    # Who knows the maze covers it. Two random walks leave the cell that they began in,
    # 1 of 9 or more, and need not see all.
    assert row["frontier_coverage"] == 100
    assert 100 / 7 < row["random_coverage"] <= 100
    assert row["map_waypoints"] > 0
    assert row["decisions_per_second"] > 0
    # Maps of smoke have no poses.
    assert row["navigator"] == "topological"
    assert row["oracle_goals"] >= 2
    assert row["oracle_success"] == 1
    for name in ("navigator", "random"):
        assert 0 <= row[f"{name}_goals"] < row["oracle_goals"]
    assert min(Image.open(figure).size) > 500

    def forbidden(*args: object, **kwargs: object) -> None:
        raise AssertionError("a finished run is made again")

    # Again, nothing is left to do.
    monkeypatch.setattr("subprocess.run", forbidden)
    monkeypatch.setattr("subprocess.Popen", forbidden)
    before = table.read_bytes()
    table.unlink()
    scaling.main()
    assert table.read_bytes() == before
    # Nor where the table alone is left, as on another machine.
    shutil.rmtree(tmp_path / "runs")
    scaling.main()
    assert table.read_bytes() == before
