"""The mazes of ``conf/maze``, on an engine."""

from dataclasses import dataclass, replace

from torchrl.envs import EnvBase

from toponav.builders import engine_world, make_env, make_layout
from toponav.config import (
    ExploreConfig,
    MazeConfig,
    PretrainConfig,
    WorldConfig,
)
from toponav.envs import Layout
from toponav.worlds import WorldSpec


@dataclass
class MazeWorldConfig(WorldConfig):
    """Settings of ``world=maze``; those of the maze are in ``conf/maze``."""


class MazeWorld:
    """A maze: it reports poses, cells and slots, so that coverage can be reported.

    Args:
        maze: the maze.
        engine: name of the engine that draws it.

    Raises:
        SettingsError: if the maze or the engine is unknown.
    """

    schema = MazeWorldConfig

    def __init__(self, maze: MazeConfig, engine: str) -> None:
        self.spec: WorldSpec = engine_world(engine)
        self.maze = maze
        self.engine = engine
        self.name = maze.name
        self.episode_length = maze.episode_length
        self.layout: Layout | None = make_layout(maze)

    @classmethod
    def make(cls, settings: ExploreConfig | PretrainConfig) -> "MazeWorld":
        """The maze of a recipe's settings."""
        return cls(settings.maze, settings.engine)

    def named(self, name: str) -> "MazeWorld":
        """Another maze of the package with the same settings."""
        return MazeWorld(replace(self.maze, name=name), self.engine)

    def make_env(
        self,
        *,
        batch_size: int,
        seed: int,
        privileged: bool = False,
        episode_length: int | None = None,
    ) -> EnvBase:
        """A batch of mazes; ``episode_length`` replaces that of the settings."""
        maze = self.maze
        if episode_length is not None:
            maze = replace(maze, episode_length=episode_length)
        return make_env(
            maze,
            engine=self.engine,
            batch_size=batch_size,
            seed=seed,
            privileged=privileged,
        )
