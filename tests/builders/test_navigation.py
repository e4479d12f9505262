import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import networkx as nx
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.envs import fake_engine
from tests.explored import Explored, make_run, navigate_settings, write_map
from toponav.builders import (
    MAP_FILE,
    POSES_FILE,
    GroundTruth,
    load_exploration,
    make_goal_places,
    make_layout,
    make_navigation_env,
    navigation,
)
from toponav.config import NavigateConfig, SettingsError, run_setting
from toponav.envs import DEFAULT_ENGINE, ENGINES, Layout
from toponav.ground_truth import GroundTruthDistances
from toponav.keys import GOAL_CELL, HEADING, PIXELS, POSITION


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


def no_pictures(source: str, *explored: object) -> str:
    config = navigate_settings(None, f"goals.source={source}")
    with pytest.raises(SettingsError) as error:
        make_goal_places(config, *explored)
    return str(error.value)


def test_without_a_picture_the_source_that_was_not_tried_is_named(
    explored, monkeypatch
):
    knowledge, truth = explored
    # All in the slot, which is no place for a goal.
    poses = truth.poses[16].expand(32, 3)
    far = GroundTruth(poses, truth.layout, truth.distances)
    said = "goals.source must have a picture of one of 7 places at least, got none from"
    assert no_pictures("map", knowledge, far) == (
        f"{said} 'map' (did you mean goals.source=walk?)"
    )
    # A walk that gets nowhere, beside a map with pictures and one without.
    lost = knowledge.map.waypoints.images, poses.numpy()
    monkeypatch.setattr(navigation, "_walk_for_views", lambda *_: lost)
    assert no_pictures("walk", knowledge, truth) == (
        f"{said} 'walk' (did you mean goals.source=map?)"
    )
    assert no_pictures("walk", knowledge, far) == (
        f"{said} 'walk' (did you mean a longer exploration with goals.source=map?)"
    )


LARGE = ("maze=random", "maze.rows=12", "maze.cols=12")


class StandInWalk:
    """A walk from cell to cell of a tree over a maze, four decisions each.

    It stands for engine, walker and rollouts, which take a minute in a large maze. The
    first two numbers of a view are the cell's row and column.
    """

    def __init__(self, layout: Layout, cell_size: float) -> None:
        self.layout, self.cell_size, self.taken = layout, cell_size, 0
        graph = layout.graph()
        self.cells = [
            parent if kind == "reverse" else child
            for parent, child, kind in nx.dfs_labeled_edges(graph, layout.cells[0])
            if kind != "nontree"
            for _ in range(4)
        ]
        self.visited = torch.zeros(1, layout.num_cells, dtype=torch.bool)

    def views(self, cells: list[tuple[int, int]]) -> tuple[torch.Tensor, torch.Tensor]:
        """Pictures, and poses from which they were taken."""
        view = torch.zeros(len(cells), 24, 36, 3, dtype=torch.uint8)
        view[:, 0, 0, :2] = torch.tensor(cells, dtype=torch.uint8)
        centres = [self.layout.centre(cell, self.cell_size) for cell in cells]
        return view, torch.tensor([(*centre, 90.0) for centre in centres])

    def rollout(self, _env: object, _walker: object, num: int, keep: object) -> object:
        """The next decisions."""
        cells = self.cells[self.taken : self.taken + num]
        self.taken += num
        view, pose = self.views(cells + [self.cells[-1]] * (num - len(cells)))
        seen = set(self.cells[: self.taken])
        self.visited[0] = torch.tensor([cell in seen for cell in self.layout.cells])
        entries = {PIXELS: view, POSITION: pose[:, :2], HEADING: pose[:, 2:]}
        return SimpleNamespace(frames=TensorDict(entries, [num]).unsqueeze(0))


@pytest.mark.slow
@pytest.mark.parametrize("source", ["walk", "map"])
def test_all_places_of_a_large_maze_get_pictures(source, explored, monkeypatch):
    config = navigate_settings(None, *LARGE, f"goals.source={source}")
    layout = make_layout(config.maze)
    world = replace(fake_engine.WORLD, view_size=(24, 36))
    walk = StandInWalk(layout, cell_size=world.motion.cell_size)
    assert layout.num_cells > 288
    # Far more than was once walked, and than any one rollout.
    assert len(walk.cells) > 2 * 900
    env = SimpleNamespace(world=world, close=lambda: None)
    monkeypatch.setattr(navigation, "make_env", lambda *_, **__: env)
    monkeypatch.setattr(navigation, "FrontierExpert", lambda *_, **__: walk)
    monkeypatch.setattr(navigation, "collect_rollout", walk.rollout)
    images, poses = walk.views(list(layout.cells))
    distances = GroundTruthDistances(
        torch.as_tensor(layout.open_mask), cell_size=world.motion.cell_size
    )
    waypoints = SimpleNamespace(images=images)
    knowledge = SimpleNamespace(map=SimpleNamespace(waypoints=waypoints))
    truth = GroundTruth(poses, layout, distances)
    places = make_goal_places(config, knowledge, truth)
    assert places.num_without == 0
    assert places.cells.tolist() == [list(cell) for cell in layout.cells]
    assert torch.equal(places.views[:, 0, 0, 0, :2].long(), places.cells)


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
        "maze must be the one that the run explored, got maze1 (did you mean maze=run?)"
    )
    # Of the same kind as the run's, which is no advice.
    other = folder / "other.txt"
    other.write_text("****\n*  *\n****\n")
    config = navigate_settings(folder, "maze=file", f"maze.path={other}")
    assert refused(config).endswith("got other (did you mean maze=run?)")
    # A wall that was opened since: no waypoint stands in one.
    kept, ring = folder / "config/layout.txt", folder / "ring.txt"
    kept.write_text(before := ring.read_text())
    assert load_exploration(navigate_settings(folder))
    ring.write_text(before.replace("* *a*", "*  a*"))
    try:
        assert ring.read_text() != before
        assert refused(navigate_settings(folder)) == (
            "maze must be the one that the run explored, got "
            f"'{ring}', which was edited since ({kept} is a copy of what it was)"
        )
    finally:
        ring.write_text(before)
        kept.unlink()
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


def test_settings_of_a_run_that_was_changed_are_read_again(tmp_path):
    (tmp_path / "config").mkdir()
    for marks in ("0.5", "0.25", "0.75"):
        text = f"maze: {{marks: {marks}}}\nreward: {{}}\n"
        (tmp_path / "config/config.yaml").write_text(text)
        assert run_setting(str(tmp_path), "maze.marks") == float(marks)


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


@pytest.mark.parametrize(
    "content",
    [
        np.array([None, "a"], dtype=object),
        b"hello",
        b"",
        np.full((32, 3), "x"),
        np.full((32, 3), 1j),
        np.full((32, 3), np.nan),
    ],
    ids=["objects", "text", "empty", "words", "complex", "nan"],
)
def test_damaged_poses_are_one_sentence_that_names_the_file(tmp_path, content):
    make_run(tmp_path)
    path = tmp_path / POSES_FILE
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.save(path, content, allow_pickle=True)
    said = refused(navigate_settings(tmp_path))
    assert said.startswith(f"run must name a complete file, got the damaged {path} (")
    assert "\n" not in said


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
