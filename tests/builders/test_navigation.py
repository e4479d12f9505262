import math
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.builders.explored import make_run, write_map
from tests.test_conf import settings
from toponav.builders import (
    Explored,
    GoalPlaces,
    closed_letters,
    find_lost_goals,
    load_explored,
    make_goal_places,
    make_navigator,
    markdown_summary,
)
from toponav.builders.run_map import MAP_FILE, POSES_FILE
from toponav.config import NavigateConfig, SettingsError
from toponav.keys import GOAL_VIEWS, IS_INIT, PATH_COST, PIXELS, PREVIOUS_REWARD


def navigate_settings(folder: Path | None, *overrides: str) -> NavigateConfig:
    run = [] if folder is None else [f"run={folder}", f"maze.path={folder}/ring.txt"]
    maze = ["maze=maze1"] if folder is None else ["maze=file"]
    found = settings("navigate", "navigate=smoke", *maze, *run, *overrides)
    assert isinstance(found, NavigateConfig)
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("explored") / "run"
    make_run(path)
    return path


@pytest.fixture(scope="module")
def explored(folder: Path) -> Explored:
    return load_explored(navigate_settings(folder))


def look(explored: Explored, waypoint: int, goal: int):
    """What an agent reads that sees a waypoint's view, and a goal's."""
    return TensorDict(
        {
            PIXELS: explored.map.images[waypoint].unsqueeze(0),
            GOAL_VIEWS: explored.map.images[goal].reshape(1, 1, 60, 80, 3),
            PREVIOUS_REWARD: torch.zeros(1, 1),
            IS_INIT: torch.ones(1, 1, dtype=torch.bool),
        },
        [1],
    )


def test_what_was_explored_comes_back_whole(explored: Explored) -> None:
    # Eight cells in a ring, four views of each; two ways between any two.
    assert explored.map.num_waypoints == 32
    assert explored.poses.shape == (32, 3)
    assert explored.ways.slot_cells == [(2, 3)]
    assert explored.map.edge_cost.eq(1).all()


def test_the_navigator_plans_on_it(explored: Explored) -> None:
    config = navigate_settings(None).navigator
    navigator = make_navigator(config, explored)
    # Networks that were never trained know no place; the truth of the plan is what
    # counts: from where it believes to be, no goal is more than four cells away.
    told = navigator(look(explored, 0, 16))
    assert 0 <= told[PATH_COST].item() <= 5
    assert navigator.localiser.stay_above is None
    assert navigator.localiser.tc_reach == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("override", "read", "value"),
    [
        ("navigator.tc_reach=0.25", lambda n: n.localiser.tc_reach, 0.25),
        ("navigator.hysteresis=true", lambda n: n.localiser.stay_above, 0.9),
        ("navigator.hops=3", lambda n: n.localiser.hops, 3),
        ("navigator.follow=2", lambda n: n.follow, 2),
        ("navigator.window=2", lambda n: n.localiser.window, 2),
        ("navigator.lookahead=2", lambda n: n.lookahead, 2),
        ("navigator.temperature=0.7", lambda n: n.sampler.temperature, 0.7),
        ("navigator.avoid_futile=false", lambda n: n.sampler.avoid_futile, False),
        ("navigator.block_after=null", lambda n: n.progress.patience, None),
        ("navigator.keep_cuts=true", lambda n: n.keep_cuts, True),
        ("navigator.fade_after=99", lambda n: n.fade_after, 99),
        ("navigator.goal_patience=7", lambda n: n.goals.patience, 7),
        ("navigator.lost_for=2", lambda n: n.lost_for, 2),
    ],
)
def test_each_setting_reaches_the_navigator(explored, override, read, value):
    config = navigate_settings(None, override).navigator
    assert read(make_navigator(config, explored)) == value


def test_networks_with_an_encoder_each_get_both_embeddings(tmp_path: Path) -> None:
    make_run(tmp_path, "model.share_encoder=false")
    explored = load_explored(navigate_settings(tmp_path))
    navigator = make_navigator(navigate_settings(None).navigator, explored)
    assert navigator.map.embeddings.shape == (32, 16)
    views = explored.map.images[:3]
    with torch.no_grad():
        both = navigator.embed(views)
        logits = explored.networks.locomotion(views, views.flip(0))
        similar = explored.networks.tc.compare(
            explored.networks.tc.embed(views), explored.map.embeddings.expand(3, -1, -1)
        )
        torch.testing.assert_close(navigator.locomotion(both, both.flip(0)), logits)
        every = torch.arange(32).expand(3, -1)
        found = navigator.localiser.similarity(both, every)
    torch.testing.assert_close(found, similar)
    assert navigator(look(explored, 0, 16))[PATH_COST].isfinite()


def test_goals_have_pictures_of_their_own_cells(folder, explored):
    places = make_goal_places(navigate_settings(folder), explored)
    # The slot is no place for a goal.
    assert places.cells.tolist() == [
        list(c) for c in explored.layout.cells if c != (2, 3)
    ]
    assert places.views.shape == (7, 4, 60, 80, 3)
    # Waypoints come in the order of the cells, four directions each, and the slot's
    # cell, which has no goal, is the fifth.
    first = [4 * number for number in (0, 1, 2, 3, 5, 6, 7)]
    assert torch.equal(places.views[:, 0], explored.map.images[first])
    assert torch.equal(places.views[0], explored.map.images[:4])


def test_one_picture_is_enough(folder, explored):
    config = navigate_settings(folder, "goals.views=1")
    assert make_goal_places(config, explored).views.shape[1] == 1


def test_a_place_without_pictures_is_one_sentence(tmp_path):
    config = make_run(tmp_path)
    write_map(tmp_path, config, cells=3)
    wanted = navigate_settings(tmp_path)
    sentence = (
        r"none of 4 cells, the first \(2, 1\), from 'map' \(did you mean a longer"
    )
    with pytest.raises(SettingsError, match=sentence):
        make_goal_places(wanted, load_explored(wanted))


def test_goals_that_are_like_no_waypoint_are_named(explored):
    config = navigate_settings(None, "navigator.tc_reach=0.9999").navigator
    navigator = make_navigator(config, explored)
    cells = torch.tensor([[1, 1], [1, 2]])
    views = torch.zeros(2, 1, 60, 80, 3, dtype=torch.uint8)
    sentence = find_lost_goals(navigator, GoalPlaces(cells, views))
    assert sentence is not None
    assert "got less for 2 of 2 cells: (1, 1) (0." in sentence
    loose = make_navigator(
        navigate_settings(None, "navigator.tc_reach=0").navigator, explored
    )
    assert find_lost_goals(loose, GoalPlaces(cells, views)) is None


def refused(config: NavigateConfig) -> str:
    with pytest.raises(SettingsError) as error:
        load_explored(config)
    return str(error.value)


def test_a_run_that_is_none_is_one_sentence(tmp_path):
    assert refused(navigate_settings(None)) == (
        "run must name the folder of an exploration, got none"
    )
    config = navigate_settings(None, f"run={tmp_path}")
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


@pytest.mark.parametrize("name", [MAP_FILE, POSES_FILE])
def test_a_run_without_a_map_is_one_sentence(tmp_path, name):
    make_run(tmp_path)
    (tmp_path / name).unlink()
    assert refused(navigate_settings(tmp_path)) == (
        f"run must name an exploration with a map, got '{tmp_path}' without {name}"
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
    ("override", "message"),
    [
        (
            "navigator.temperature=-1",
            "navigator.temperature must be at least 0, got -1",
        ),
        ("navigator.hops=0", "navigator.hops must be at least 1, got 0"),
        ("navigator.follow=-1", "navigator.follow must be at least 0, got -1"),
        ("navigator.block_after=0", "navigator.block_after must be at least 2, got 0"),
        (
            "navigator.tc_reach=2",
            r"navigator.tc_reach must lie in \[0, 0.9999\], got 2",
        ),
        ("navigator.unwalked_cost=0", "unwalked_cost must be at least 1, got 0"),
        ("goals.views=0", r"goals.views must lie in \[1, 16\], got 0 \(did you mean 1"),
        ("goals.source=thief", "goals.source must be one of map, walk, got thief"),
        ("evaluate.episodes=0", "evaluate.episodes must be at least 1, got 0"),
        ("evaluate.policies=[me]", "one of navigator, oracle, random, got me"),
        ("evaluate.policies=[]", "evaluate.policies must name one, got none"),
        ("video.format=avi", "video.format must be one of mp4, gif, got avi"),
        ("video.height=9", "video.height must be at least 64, got 9"),
        ("maze.goal=false", "maze.goal must be true, so that there is a goal"),
        ("threads=0", "threads must be at least 1, got 0"),
    ],
)
def test_a_value_out_of_range_is_refused(override, message):
    with pytest.raises(SettingsError, match=message):
        navigate_settings(None, override)


def test_a_table_says_nothing_where_there_is_nothing():
    rows = [{"policy": "oracle", "goals": 2.0, "delay": math.nan}]
    rows.append({"policy": "navigator", "goals": 1.0, "delay": 7.0})
    rows[1] |= {"goals_low": 0.5, "goals_high": 1.5}
    table = markdown_summary(rows, title="ring").splitlines()
    assert table[2] == "|  | oracle | navigator |"
    assert table[4:] == ["| goals | 2 | 1 (0.5 to 1.5) |", "| delay |  | 7 |"]
    assert closed_letters(["a"]) == "a closed"
