"""Mazes: layouts and environments."""

from collections.abc import Iterable

from toponav.config import MazeConfig, refusing
from toponav.envs import (
    Layout,
    MazeEnv,
    load_engine,
    load_layout_file,
    load_maze,
    make_random_layout,
)
from toponav.worlds import WorldSpec


@refusing("")
def make_layout(config: MazeConfig) -> Layout:
    """The maze that a configuration names; `SettingsError` if it is not valid."""
    if config.name == "file":
        assert config.path is not None  # MazeConfig checks it
        return _read_layout(config.path)
    if config.name == "random":
        size = config.rows, config.cols
        return make_random_layout(*size, seed=config.seed, loops=config.loops)
    return load_maze(config.name)


@refusing("maze.path: ")
def _read_layout(path: str) -> Layout:
    return load_layout_file(path)


@refusing("")
def engine_world(engine: str) -> WorldSpec:
    """The numbers of the mazes on an engine.

    `SettingsError` if there is no such engine, `EngineError` if it is not installed.
    """
    found = load_engine(engine)
    found.check()
    return found.world


@refusing("maze: ")
def make_env(
    config: MazeConfig,
    *,
    engine: str,
    layout: Layout | None = None,
    batch_size: int | None = None,
    seed: int = 0,
    privileged: bool = False,
    goal_cells: Iterable[tuple[int, int]] | None = None,
    depth: tuple[int, int] | None = None,
    velocity: bool = False,
) -> MazeEnv:
    """A batch of mazes on an engine; the other arguments are those of `MazeEnv`.

    ``layout`` is the maze where it was made or read before. Raises `SettingsError` if
    the settings do not fit the maze, and `EngineError` if the engine is not installed
    or cannot load it.
    """
    layout = make_layout(config) if layout is None else layout
    engine_world(engine)  # refuses one that is unknown or not installed
    return MazeEnv(
        layout,
        engine=engine,
        batch_size=batch_size,
        apples=config.apples,
        goal=config.goal,
        blocked=config.blocked,
        goal_cells=goal_cells,
        episode_length=config.episode_length,
        texture_seed=config.texture_seed,
        paintings=config.paintings,
        marks=config.marks,
        depth=depth,
        velocity=velocity,
        privileged=privileged,
        seed=seed,
    )
