"""Files that belong to one writing of a map, whenever the writer is killed."""

import numpy as np
import pytest

from tests.graph.grey_world import episode, make_map
from toponav.builders import (
    MAP_FILE,
    PLACES_FILE,
    POSES_FILE,
    find_beside,
    mend_beside,
    name_contents,
    next_path,
    put_beside,
)
from toponav.graph import load_map, save_map
from toponav.runs import write_array

STEPS = 4


def write(folder, turn, steps=STEPS):
    """Write the poses and a map, as `MapGrowth` does, up to one of its steps."""
    mend_beside(folder)
    grown = make_map()
    grown.add_episode(episode(*range(0, 10 * turn, 12), views=True))
    if steps > 0:
        write_array(next_path(folder / POSES_FILE), np.full((turn, 3), float(turn)))
    if steps > 1 and turn % 2:
        next_path(folder / PLACES_FILE).write_bytes(bytes([turn]))
    about = {"maze": "maze1", "turn": str(turn)} | name_contents(folder)
    if steps > 2:
        save_map(grown.state_dict(), folder / MAP_FILE, about=about)
    if steps > 3:
        put_beside(folder, about)


def check(folder):
    """What is found belongs to the map; returns the turn in which it was written."""
    _, about = load_map(folder / MAP_FILE)
    turn = int(about["turn"])
    poses = np.load(find_beside(folder, POSES_FILE, about))
    # Of another writing it would have another number of rows.
    assert poses.shape == (turn, 3)
    places = find_beside(folder, PLACES_FILE, about)
    assert (places is None) == (turn % 2 == 0)
    assert places is None or places.read_bytes() == bytes([turn])
    return turn


@pytest.mark.parametrize("first", [5, 8])
@pytest.mark.parametrize("second", [3, 6, 9])
@pytest.mark.parametrize("steps", range(STEPS))
def test_a_kill_at_any_step_leaves_a_pair(tmp_path, first, second, steps):
    write(tmp_path, first)
    assert check(tmp_path) == first
    write(tmp_path, second, steps=steps)
    assert check(tmp_path) == (second if steps > 2 else first)
    # The run that goes on begins with the pair, and is killed as well.
    write(tmp_path, 7, steps=0)
    assert check(tmp_path) == (second if steps > 2 else first)
    names = {path.name for path in tmp_path.iterdir()}
    assert not any(".next" in name for name in names), names
    write(tmp_path, 7)
    assert check(tmp_path) == 7


def test_a_kill_before_the_first_map_leaves_nothing(tmp_path):
    write(tmp_path, 5, steps=2)
    mend_beside(tmp_path)
    assert not list(tmp_path.iterdir())


def test_poses_of_another_map_are_not_taken(tmp_path):
    write(tmp_path, 5)
    np.save(tmp_path / POSES_FILE, np.zeros((5, 3)))
    _, about = load_map(tmp_path / MAP_FILE)
    assert find_beside(tmp_path, POSES_FILE, about) is None


def test_a_map_of_an_earlier_version_takes_what_lies_beside_it(tmp_path):
    write(tmp_path, 5)
    path = tmp_path / POSES_FILE
    assert find_beside(tmp_path, POSES_FILE, {"maze": "maze1"}) == path
