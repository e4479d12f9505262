"""The mazes of ``conf/maze``, on an engine."""

from collections.abc import Collection
from dataclasses import dataclass, replace

from torchrl.envs import EnvBase

from toponav.builders import World, engine_world, make_env, make_layout
from toponav.config import (
    ExploreConfig,
    PretrainConfig,
    WorldConfig,
    maze_label,
    refusing,
)

# Height and width of a depth picture.
_DEPTH = (20, 18)


@dataclass
class MazeWorldConfig(WorldConfig):
    """Settings of ``world=maze``; those of the maze are in ``conf/maze``."""

    group = "maze"


class MazeWorld(World):
    """A maze: it reports poses, cells and slots, so that coverage can be reported."""

    schema = MazeWorldConfig
    senses = ("velocity", "depth")

    def __init__(self, settings: ExploreConfig | PretrainConfig) -> None:
        self.maze, self.engine = settings.maze, settings.engine
        self.spec = engine_world(self.engine)
        self.name = maze_label(self.maze.name, self.maze.path)
        self.episode_length = self.maze.episode_length
        self.layout = make_layout(self.maze)
        with refusing("maze: "):
            self.blocked = self.layout.check_slots(self.maze.blocked)

    def make_env(
        self,
        *,
        batch_size: int,
        seed: int,
        privileged: bool = False,
        episode_length: int | None = None,
        senses: Collection[str] = (),
    ) -> EnvBase:
        """A batch of mazes; ``episode_length`` replaces that of the settings."""
        length = episode_length or self.episode_length
        return make_env(
            replace(self.maze, episode_length=length),
            layout=self.layout,
            engine=self.engine,
            batch_size=batch_size,
            seed=seed,
            privileged=privileged,
            depth=_DEPTH if "depth" in senses else None,
            velocity="velocity" in senses,
        )
