import re
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.envs import fake_engine
from tests.explored import make_run, write_map
from tests.test_conf import settings
from toponav.builders import (
    MAP_FILE,
    POSES_FILE,
    AgentKnowledge,
    GroundTruth,
    load_exploration,
    make_goal_places,
    make_navigation_env,
)
from toponav.config import NavigateConfig, SettingsError, run_setting
from toponav.envs import DEFAULT_ENGINE, ENGINES
from toponav.keys import GOAL_CELL

Explored = tuple[AgentKnowledge, GroundTruth]


def navigate_settings(folder: Path | None, *overrides: str) -> NavigateConfig:
    run = ["maze=maze1"] if folder is None else [f"run={folder}"]
    found = settings("navigate", "navigate=smoke", *run, *overrides)
    assert isinstance(found, NavigateConfig)
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("explored") / "run"
    make_run(path)
    return path


@pytest.fixture(scope="module")
def explored(folder: Path) -> Explored:
    return load_exploration(navigate_settings(folder))


def test_what_was_explored_comes_back_whole(explored: Explored) -> None:
    knowledge, truth = explored
    # Eight cells in a ring, four views of each; two paths between any two.
    assert knowledge.map.num_waypoints == 32
    assert truth.poses.shape == (32, 3)
    assert truth.distances.slot_cells == [(2, 3)]
    assert knowledge.map.edge_cost.eq(1).all()


def test_the_maze_is_that_of_the_run_unless_one_is_named(folder: Path) -> None:
    maze = navigate_settings(folder, "maze.blocked=[a]").maze
    assert (maze.name, maze.path) == ("file", str(folder / "ring.txt"))
    assert (maze.blocked, maze.goal, maze.episode_length) == (["a"], True, 60)
    assert navigate_settings(folder, "maze=maze3").maze.name == "maze3"


def test_settings_of_a_run_that_are_unknown_now_are_not_read(tmp_path: Path) -> None:
    make_run(tmp_path)
    file = tmp_path / "config/config.yaml"
    file.write_text(file.read_text() + "former: {setting: 3}\n")
    assert load_exploration(navigate_settings(tmp_path))[0].map.num_waypoints == 32


def test_goals_have_pictures_of_their_own_cells(folder, explored):
    knowledge, truth = explored
    places = make_goal_places(navigate_settings(folder), *explored)
    # The slot is no place for a goal.
    cells = [list(cell) for cell in truth.layout.cells if cell != (2, 3)]
    assert places.cells.tolist() == cells
    assert places.num_without == 0
    images = knowledge.map.waypoints.images
    assert places.views.shape == (7, 4, *images.shape[1:])
    # Waypoints come in the order of the cells, four directions each, and the slot's
    # cell, which has no goal, is the fifth.
    first = [4 * number for number in (0, 1, 2, 3, 5, 6, 7)]
    assert torch.equal(places.views[:, 0], images[first])
    assert torch.equal(places.views[0], images[:4])


def test_one_picture_is_enough(folder, explored):
    config = navigate_settings(folder, "goals.views=1")
    assert make_goal_places(config, *explored).views.shape[1] == 1


def test_goals_are_only_where_there_are_pictures(tmp_path):
    config = make_run(tmp_path)
    write_map(tmp_path, config, cells=3)
    wanted = navigate_settings(tmp_path)
    places = make_goal_places(wanted, *load_exploration(wanted))
    assert places.cells.tolist() == [[1, 1], [1, 2], [1, 3]]
    assert places.num_without == 4
    env = make_navigation_env(wanted, places, envs=2, seed=0)
    try:
        drawn = {
            tuple(one) for _ in range(6) for one in env.reset()[GOAL_CELL].tolist()
        }
    finally:
        env.close()
    assert drawn <= {(1, 1), (1, 2), (1, 3)}
    assert len(drawn) > 1


def test_no_picture_at_all_is_one_sentence(tmp_path, explored):
    knowledge, truth = explored
    # All in the slot, which is no place for a goal.
    poses = truth.poses[16].expand(32, 3)
    far = GroundTruth(poses, truth.layout, truth.distances)
    config = navigate_settings(None)
    with pytest.raises(SettingsError, match="of one of 7 places at least, got none"):
        make_goal_places(config, knowledge, far)


def refused(config: NavigateConfig) -> str:
    with pytest.raises(SettingsError) as error:
        load_exploration(config)
    return str(error.value)


def test_a_run_that_is_none_is_one_sentence(tmp_path):
    assert refused(navigate_settings(None)) == (
        "run must name the folder of an exploration, got none"
    )
    config = navigate_settings(None, f"run={tmp_path}", f"engine={DEFAULT_ENGINE}")
    assert refused(config) == (
        f"run must name the folder of an exploration, got '{tmp_path}'"
    )
    (tmp_path / "config").mkdir()
    (tmp_path / "config/config.yaml").write_text("maze: {}\n")
    assert "got that of another recipe" in refused(config)


def test_another_maze_is_one_sentence(folder):
    config = navigate_settings(None, f"run={folder}")
    assert refused(config) == (
        "maze must be the one that the run explored, got maze1 (did you mean "
        "maze=file?)"
    )
    config = navigate_settings(folder, "maze.texture_seed=5")
    assert refused(config) == "maze.texture_seed must be 0, as in the run, got 5"


def test_a_run_of_another_world_is_one_sentence(tmp_path):
    make_run(tmp_path)
    file = tmp_path / "config/config.yaml"
    file.write_text(
        re.sub("world:\n  name: maze", "world:\n  name: gym", file.read_text())
    )
    assert refused(navigate_settings(tmp_path)) == (
        "run must name the exploration of a maze, which navigation needs, got "
        f"'{tmp_path}' with world=gym"
    )


def test_a_run_of_an_earlier_version_is_one_sentence(tmp_path):
    (tmp_path / "config").mkdir()
    old = "maze: {name: maze1}\nreward: {kind: coverage}\n"
    (tmp_path / "config/config.yaml").write_text(old)
    with pytest.raises(SettingsError, match=r"of this version, got .* earlier version"):
        run_setting(str(tmp_path), "maze.marks")


@pytest.mark.parametrize("name", ["networks.pt", MAP_FILE, POSES_FILE])
def test_a_run_without_a_map_is_one_sentence(tmp_path, name):
    make_run(tmp_path)
    (tmp_path / name).unlink()
    assert refused(navigate_settings(tmp_path)) == (
        "run must name an exploration with networks and a map, which reward=novelty "
        f"leaves, and others that get `pretrained`, got '{tmp_path}' without {name}"
    )


def test_a_broken_map_is_one_sentence(tmp_path):
    config = make_run(tmp_path)
    whole = (tmp_path / MAP_FILE).read_bytes()
    (tmp_path / MAP_FILE).write_bytes(whole[: len(whole) // 2])
    assert refused(navigate_settings(tmp_path)).startswith("run: a map must be a file")
    write_map(tmp_path, config)
    np.save(tmp_path / POSES_FILE, np.zeros((5, 3)))
    assert "a row of three for each of 32 waypoints, got (5, 3)" in refused(
        navigate_settings(tmp_path)
    )
    write_map(tmp_path, config, cells=0)
    assert "whose map has waypoints, got an empty map" in refused(
        navigate_settings(tmp_path)
    )


def test_the_world_is_that_of_the_engine_of_the_run(tmp_path, monkeypatch):
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    make_run(tmp_path, "engine=fake", "policy.view_size=36")
    config = navigate_settings(tmp_path)
    assert config.engine == "fake"
    knowledge, truth = load_exploration(config)
    assert knowledge.world == fake_engine.WORLD
    assert truth.distances.cell_size == fake_engine.WORLD.motion.cell_size
    places = make_goal_places(config, knowledge, truth)
    env = make_navigation_env(config, places, envs=2, seed=0)
    assert env.world == fake_engine.WORLD
    env.close()


def test_an_earlier_run_names_no_engine_and_had_the_default(tmp_path):
    make_run(tmp_path)
    file = tmp_path / "config/config.yaml"
    file.write_text(file.read_text().replace("engine: vizdoom\n", ""))
    assert navigate_settings(tmp_path).engine == DEFAULT_ENGINE


def test_an_engine_with_other_views_is_one_sentence(folder, monkeypatch):
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    config = navigate_settings(folder, "engine=fake")
    assert refused(config).startswith("run must name networks for views of 24 x 36")
    config = navigate_settings(folder, "engine=fak")
    assert "engine must be one of dmlab, fake, vizdoom, got 'fak'" in refused(config)
