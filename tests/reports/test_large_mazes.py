"""What is said of a maze that is larger than the defaults are for."""

import math

from tests.exploring import explore_settings, world_of
from toponav.reports import large_maze_hints

MAZE = ("maze=random", "maze.rows=15", "maze.cols=15", "maze.seed=3")


def hints(*words: str) -> list[str]:
    config = explore_settings(*words)
    return large_maze_hints(config, world_of(config))


def large(length: int, *words: str) -> list[str]:
    return hints(*MAZE, f"maze.episode_length={length}", *words)


def test_small_mazes_need_nothing() -> None:
    assert hints("maze=maze1") == []
    # Episodes of smoke, 64 decisions, cross 16 of its cells.
    assert hints("maze=maze3", "maze.episode_length=64") == []


def test_short_episodes_of_a_large_maze() -> None:
    # 15 x 15 rooms and what joins them. A cell takes 128 / 33.1 = 3.867 decisions:
    # 1,800 / 3.867 = 465.5 cells; 1,800 / 49 = 36.73 decisions a cell.
    cells = world_of(explore_settings(*MAZE)).layout.num_cells
    assert cells > 465
    (length, memory) = large(1_800)
    start = f"An episode of 1,800 decisions crosses at most 465 of the {cells} open ce"
    assert length.startswith(start)
    assert f"maze.episode_length={round(cells * 1_800 / 49)} has" in length
    assert memory.startswith("An episode remembers 200 waypoints, fewer than every sec")
    assert "reward.capacity=null" in memory


def test_a_map_that_is_fed_few_views() -> None:
    few = "maze.episode_length=14000", "reward.capacity=null", "collect.envs=64"
    few += "collect.decisions=400000", "map.poses=true"
    cells = world_of(explore_settings(*MAZE)).layout.num_cells
    # 400,000 x 8 / 64 = 50,000 views, 6,250 of each maze; 500 for each cell are enough.
    (hint,) = hints(*MAZE, *few, "map.envs=8")
    assert hint.startswith(f"The map is fed {round(50_000 / cells)} views for each of")
    enough = math.ceil(500 * cells / 6_250)
    assert f"map.envs={enough} feeds it those of {enough} of the 64 mazes" in hint
    assert hints(*MAZE, *few, f"map.envs={enough}") == []
    # 250 views a cell are not few.
    least = math.ceil(250 * cells / 6_250)
    assert hints(*MAZE, *few, f"map.envs={least}") == []
    assert len(hints(*MAZE, *few, f"map.envs={least - 1}")) == 1
    # No map by poses, or the views of all mazes.
    for more in "map.poses=false", "map.envs=null", "map.envs=64":
        assert hints(*MAZE, *few, "map.envs=8", more) == []


def test_what_is_said_helps() -> None:
    assert large(14_000, "reward.capacity=null") == []
    assert len(large(14_000)) == len(large(100, "reward.capacity=null")) == 1
    # A memory of another kind is no list of waypoints.
    assert large(14_000, "reward=ex2", "reward.capacity=20") == []
