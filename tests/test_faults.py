"""What benchmarks/faults.py looks for in the folder of a killed run is found."""

from pathlib import Path

import pytest
import torch

from tests.benchmarks.loading import load_benchmark


def test_a_damaged_file_of_each_kind_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = load_benchmark("fault_files", monkeypatch)
    torch.save({"a": torch.zeros(300)}, tmp_path / "a.pt")
    (tmp_path / "b.csv").write_text("a,b\n1,2\n")
    (tmp_path / "c.json").write_text("{}")
    (tmp_path / ".c.17.json").write_text("{")
    assert files.broken_files(tmp_path) == []
    assert files.temporary_files(tmp_path) == [".c.17.json"]
    for name in ("a.pt", "b.csv", "c.json"):
        content = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(content[:-1])
    (tmp_path / "d.xyz").touch()
    found = [name.partition(":")[0] for name in files.broken_files(tmp_path)]
    assert found == ["a.pt", "b.csv", "c.json", "d.xyz"]


@pytest.mark.slow
def test_explorations_and_tours_start_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six explorations and six tours in one directory: 12 folders, all whole.

    The long form has 24 tours, and explorations that share a pre-training.
    """
    few = ("collect.decisions=128", "maze.episode_length=16", "evaluate.episodes=1")
    explore = ("explore", "scale=smoke", "reward=coverage", "policy.hidden=16", *few)
    together = load_benchmark("fault_together", monkeypatch)
    found = together.start_together(
        tmp_path, [explore] * 6 + [("tour", "scale=smoke")] * 6
    )
    assert found["ended_well"] == 12, found["said"]
    assert found["folders"] == {"explore": 6, "tour": 6}
    none = ("hangs", "tracebacks", "broken", "stray", "left")
    assert [found[name] for name in none] == [0, 0, [], [], []]
