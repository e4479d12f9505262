"""What a world is made of, and what its environments are made of later."""

import pickle
from contextlib import closing
from pathlib import Path

import pytest

from tests.envs.layouts import LANE
from tests.exploring import explore_settings, world_of
from toponav.config import SettingsError
from toponav.envs import ENGINES


def test_the_file_of_a_maze_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Collecting processes get a pickled world, maybe on another machine.
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    path = tmp_path / "lane.txt"
    path.write_text(LANE.text)
    words = "maze=file", f"maze.path='{path}'", "engine=fake"
    world = pickle.loads(pickle.dumps(world_of(explore_settings(*words))))
    path.unlink()
    with closing(world.make_env(batch_size=2, seed=0)) as env:
        assert env.layout == world.layout
        assert env.layout.text == LANE.text


def test_slots_that_stay_closed_are_no_floor() -> None:
    world = world_of(explore_settings("maze=maze1", "maze.blocked=[b]"))
    assert world.layout is not None
    plan, cell = world.layout.open_mask, world.layout.slots["b"]
    assert plan[cell]
    closed = (world.floor.numpy() != plan).nonzero()
    assert [tuple(axis) for axis in closed] == [(cell[0],), (cell[1],)]


def test_a_slot_that_there_is_not_is_refused_before_anything_starts() -> None:
    rule = r"^maze: blocked slots must be slots of maze1 \(a, b\), got 'q'$"
    with pytest.raises(SettingsError, match=rule):
        world_of(explore_settings("maze=maze1", "maze.blocked=[q]"))
