from pathlib import Path

import pytest
import torch

from toponav.runs import reading_checkpoint, save_atomically

HEADER = {"kind": "test", "version": 1}


def load(path: Path) -> dict[str, object]:
    with reading_checkpoint(path, "resume", HEADER, "a test") as found:
        return found


def test_a_write_that_fails_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "state.pt"
    save_atomically({**HEADER, "update": 1}, path)

    def run_out_of_space(state: object, file: object) -> None:
        file.write(b"half of it")
        raise OSError("no space left")

    monkeypatch.setattr(torch, "save", run_out_of_space)
    with pytest.raises(OSError, match="no space left"):
        save_atomically({"update": 2}, path)
    assert load(path)["update"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["state.pt"]


def test_tensors_and_plain_values_come_back(tmp_path: Path) -> None:
    state = {**HEADER, "a": torch.arange(3), "b": [1, 2.5, "x", None], "c": {"d": True}}
    save_atomically(state, tmp_path / "state.pt")
    loaded = load(tmp_path / "state.pt")
    assert torch.equal(loaded["a"], state["a"])
    assert (loaded["b"], loaded["c"]) == (state["b"], state["c"])
