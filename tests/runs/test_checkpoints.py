import io
import resource
import time
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from toponav.config import SettingsError
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


def holding_itself() -> dict[str, object]:
    found: dict[str, object] = {}
    found["again"] = found
    return found


def doubled(depth: int, pair: Callable[[object], object]) -> object:
    """A container that holds the next one twice, and so on: ``2 ** depth`` of them."""
    found: object = 0
    for _ in range(depth):
        found = pair(found)
    return found


class Gigabytes:
    """A few bytes in a file, from which Python makes many."""

    def __reduce__(self) -> tuple[type, tuple[int]]:
        return bytearray, (1_500_000_000,)


class Replaced:
    """A dictionary of which the file also says what one of its methods is."""

    def __reduce__(self) -> tuple[type, tuple[()], dict[str, int]]:
        return OrderedDict, (), {"items": 5}


class Keyed:
    """A dictionary with a key that takes long to compare, and is not when written."""

    def __init__(self, depth: int) -> None:
        self.key = doubled(depth, lambda one: (one, one))

    def __reduce__(self) -> tuple[type, tuple[object]]:
        return OrderedDict, ([(self.key, 1)],)


#: Entries of a file whose checksums fit, and what is said of it. Without a limit those
#: that double take seconds: 40 levels would take days.
CRAFTED: dict[str, tuple[Callable[[], dict[str, object]], str]] = {
    "itself": (lambda: {"weights": holding_itself()}, "entries inside each other"),
    "doubled": (
        lambda: {"a": doubled(22, lambda one: {"b": one, "c": one})},
        "entries inside each other",
    ),
    "doubled kind": (
        lambda: {"kind": doubled(25, lambda one: [one, one])},
        "entries inside each other",
    ),
    "doubled key": (lambda: {"a": Keyed(27)}, "tuples inside each other"),
    "kind": (lambda: {"kind": [torch.ones(9)] * 50_000}, "version 1, got .*with list"),
    "two lines": (lambda: {"kind": "a\nb"}, "version 1, got .* with a b 1"),
    "gigabytes": (lambda: {"a": Gigabytes()}, "with __builtin__ bytearray, which no"),
    "no method": (lambda: {"a": Replaced()}, "got the damaged "),
}


@pytest.mark.parametrize("how", list(CRAFTED))
def test_a_crafted_file_is_refused_at_once(tmp_path: Path, how: str) -> None:
    path = tmp_path / "state.pt"
    make, said = CRAFTED[how]
    torch.save({**HEADER, **make()}, path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.process_time()
    with pytest.raises(SettingsError, match=rf"^resume must name .*{said}") as caught:
        load(path)
    assert time.process_time() - started < 1
    # Kilobytes.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000
    assert "\n" not in str(caught.value)


def test_a_file_of_another_format_before_an_archive_is_refused(tmp_path: Path) -> None:
    path, archive = tmp_path / "state.pt", io.BytesIO()
    torch.save(HEADER, archive)
    torch.save(HEADER, path, _use_new_zipfile_serialization=False)
    path.write_bytes(path.read_bytes() + archive.getvalue())
    # torch reads the beginning, and the checksums are those of the end.
    assert torch.load(path, weights_only=True) == HEADER
    with pytest.raises(SettingsError, match="resume must name a complete file"):
        load(path)
