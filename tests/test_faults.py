"""What benchmarks/faults.py looks for in the folder of a killed run is found."""

from pathlib import Path

import torch

from benchmarks import faults


def test_a_damaged_file_of_each_kind_is_found(tmp_path: Path) -> None:
    torch.save({"a": torch.zeros(300)}, tmp_path / "a.pt")
    (tmp_path / "b.csv").write_text("a,b\n1,2\n")
    (tmp_path / "c.json").write_text("{}")
    (tmp_path / ".c.17.json").write_text("{")
    assert faults.broken_files(tmp_path) == []
    assert faults.temporary_files(tmp_path) == [".c.17.json"]
    for name in ("a.pt", "b.csv", "c.json"):
        content = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(content[:-1])
    (tmp_path / "d.xyz").touch()
    found = [name.partition(":")[0] for name in faults.broken_files(tmp_path)]
    assert found == ["a.pt", "b.csv", "c.json", "d.xyz"]
