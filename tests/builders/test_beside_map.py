"""Files that belong to one writing of a map, whenever the writer is killed."""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure
from torch import Tensor

from tests.graph.grey_world import episode, make_map
from toponav.builders import (
    MAP_FILE,
    PLACES_FILE,
    POSES_FILE,
    MapNetworks,
    find_beside,
    load_places,
    mend_beside,
    next_path,
)
from toponav.graph import load_map
from toponav.modules import PlaceNetwork
from toponav.training import map_writer
from toponav.training.map_truth import MapTruth, Snapshot
from toponav.training.map_writer import MapWriter

#: What `MapWriter` calls for one map, in this order.
CALLS = (
    *("mend_beside", "write_array", "save_places", "write_history"),
    *("name_contents", "save_map", "put_beside", "save_figure"),
)
#: A writing that is killed at one of these has replaced the map.
AFTER_MAP = CALLS[CALLS.index("save_map") + 1 :]


class KilledError(Exception):
    """Instead of a signal, at which nothing more would happen."""


class NoTruth(MapTruth):
    """Judges nothing and draws nothing: about the poses it is asked for."""

    def __init__(self) -> None:
        pass

    def lengths(self, now: Snapshot) -> Tensor:
        return torch.empty(0)

    def measure(self, now: Snapshot, lengths: Tensor) -> dict[str, Any]:
        return {"components": 1}

    def draw(self, now: Snapshot, lengths: Tensor, title: str, parts: str) -> Figure:
        return Figure(figsize=(1, 1))


def snapshot(turn: int) -> Snapshot:
    """So many poses as ``turn``, and networks for so many places if it is odd."""
    grown = make_map()
    grown.add_episode(episode(*range(0, 10 * turn, 12), views=True))
    state = grown.state_dict()
    places = MapNetworks(PlaceNetwork(turn, 2, hidden=2)) if turn % 2 else None
    return Snapshot(
        row={"decisions": turn},
        state=state,
        views=state["images"],
        cost=torch.ones(len(state["edges"])),
        poses=torch.full((turn, 3), float(turn)),
        decisions_to_cover=0.0,
        pretraining_decisions=0.0,
        networks=places,
    )


def write(folder: Path, turn: int) -> None:
    """Write one map, named by its ``turn``, to the end."""
    writer = MapWriter(str(turn), NoTruth())
    writer.write(folder, lambda: snapshot(turn), [])
    writer.wait()


def write_until(folder: Path, turn: int, call: str) -> None:
    """Write a map, and be killed when it comes to a call."""

    def die(*_: object, **__: object) -> None:
        raise KilledError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(map_writer, call, die)
        with pytest.raises(KilledError):
            write(folder, turn)


def check(folder: Path) -> int:
    """What is found belongs to the map; returns the turn in which it was written."""
    _, about = load_map(folder / MAP_FILE)
    turn = int(about["maze"])
    path = find_beside(folder, POSES_FILE, about)
    assert path is not None
    # Of another writing it would have another number of rows.
    assert np.load(path).shape == (turn, 3)
    path = find_beside(folder, PLACES_FILE, about)
    assert (path is None) == (turn % 2 == 0)
    if path is not None:
        load_places(path, num_places=turn, embedding_size=2, setting="run")
    return turn


def waiting(folder: Path) -> list[Path]:
    """Files that wait for their map."""
    paths = (next_path(folder / name) for name in (POSES_FILE, PLACES_FILE))
    return [path for path in paths if path.exists()]


@pytest.mark.parametrize(("first", "second"), [(5, 9), (5, 6), (8, 3), (8, 6)])
@pytest.mark.parametrize("call", CALLS)
def test_a_kill_at_any_call_leaves_a_pair(
    tmp_path: Path, first: int, second: int, call: str
) -> None:
    if second % 2 == 0 and call == "save_places":
        call = "write_history"  # the next one, where there are none
    write(tmp_path, first)
    assert check(tmp_path) == first
    write_until(tmp_path, second, call)
    found = second if call in AFTER_MAP else first
    assert check(tmp_path) == found
    # The run that goes on begins with the pair, and is killed again and again.
    for later in CALLS:
        write_until(tmp_path, 7, later)
        assert check(tmp_path) == (7 if later in AFTER_MAP else found), later
    write(tmp_path, 7)
    assert check(tmp_path) == 7
    assert waiting(tmp_path) == []


@contextmanager
def dying(changes: int) -> Iterator[None]:
    """Be killed after so many files were given another name or removed."""
    left = changes

    def until(change: Any) -> Any:
        def change_or_die(*arguments: Any, **options: Any) -> Any:
            nonlocal left
            left -= 1
            # Who is dead removes no halves, either.
            if left < 0:
                raise KilledError
            return change(*arguments, **options)

        return change_or_die

    with pytest.MonkeyPatch.context() as patch:
        for name in ("replace", "unlink"):
            patch.setattr(Path, name, until(getattr(Path, name)))
        yield


@pytest.mark.parametrize(("first", "second"), [(5, 9), (5, 6), (8, 3), (8, 6)])
def test_a_kill_between_any_two_changes_of_files_leaves_a_pair(
    tmp_path: Path, first: int, second: int
) -> None:
    for changes in itertools.count():
        folder = tmp_path / str(changes)
        folder.mkdir()
        write(folder, first)
        try:
            with dying(changes):
                write(folder, second)
        except KilledError:
            found = check(folder)
            assert found in (first, second)
            mend_beside(folder)
            assert check(folder) == found
            assert waiting(folder) == []
        else:
            break
    assert changes > 10


@pytest.mark.parametrize("call", CALLS[: CALLS.index("save_map") + 1])
def test_a_kill_before_the_first_map_leaves_nothing(tmp_path: Path, call: str) -> None:
    write_until(tmp_path, 5, call)
    mend_beside(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} <= {"map.csv"}


def test_poses_of_another_map_are_not_taken(tmp_path: Path) -> None:
    write(tmp_path, 5)
    np.save(tmp_path / POSES_FILE, np.zeros((5, 3)))
    _, about = load_map(tmp_path / MAP_FILE)
    assert find_beside(tmp_path, POSES_FILE, about) is None


def test_a_map_of_an_earlier_version_takes_what_lies_beside_it(tmp_path: Path) -> None:
    write(tmp_path, 5)
    path = tmp_path / POSES_FILE
    assert find_beside(tmp_path, POSES_FILE, {"maze": "maze1"}) == path
