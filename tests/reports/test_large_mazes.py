"""What is said of a maze that is larger than the defaults are for."""

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
    # 1,800 / 3.867 = 465.5 cells; 1,800 / 63 = 28.57 decisions a cell.
    cells = world_of(explore_settings(*MAZE)).layout.num_cells
    assert cells > 465
    (length, memory) = large(1_800)
    start = f"An episode of 1,800 decisions crosses at most 465 of the {cells} open ce"
    assert length.startswith(start)
    assert f"maze.episode_length={round(cells * 1_800 / 63)} has" in length
    assert memory.startswith("An episode remembers 200 waypoints, fewer than every sec")
    assert "reward.capacity=null" in memory


def test_what_is_said_helps() -> None:
    assert large(14_000, "reward.capacity=null") == []
    assert len(large(14_000)) == len(large(100, "reward.capacity=null")) == 1
    # A memory of another kind is no list of waypoints.
    assert large(14_000, "reward=ex2", "reward.capacity=20") == []
