from pathlib import Path

import pytest
import torch

from toponav.runs.checkpoints import load_checkpoint, save_atomically


def test_a_write_that_fails_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "state.pt"
    save_atomically({"update": 1}, path)

    def run_out_of_space(state: object, file: object) -> None:
        file.write(b"half of it")
        raise OSError("no space left")

    monkeypatch.setattr(torch, "save", run_out_of_space)
    with pytest.raises(OSError, match="no space left"):
        save_atomically({"update": 2}, path)
    assert load_checkpoint(path, "resume") == {"update": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["state.pt"]


def test_tensors_and_plain_values_come_back(tmp_path: Path) -> None:
    state = {"a": torch.arange(3), "b": [1, 2.5, "x", None], "c": {"d": True}}
    save_atomically(state, tmp_path / "state.pt")
    loaded = load_checkpoint(tmp_path / "state.pt", "resume")
    assert torch.equal(loaded["a"], state["a"])
    assert (loaded["b"], loaded["c"]) == (state["b"], state["c"])
