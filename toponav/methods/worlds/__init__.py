"""Worlds: where an agent acts. A new one is a file here and a line in `WORLDS`."""

from dataclasses import replace

from toponav.builders import World
from toponav.config import ExploreConfig, PretrainConfig, require
from toponav.methods.worlds.gym import GymWorld
from toponav.methods.worlds.maze import MazeWorld

#: By the name of their settings, ``conf/world/<name>.yaml``.
WORLDS: dict[str, type[World]] = {
    "maze": MazeWorld,
    "gym": GymWorld,
}


def make_world(settings: ExploreConfig | PretrainConfig) -> World:
    """The world that the settings name; `SettingsError` if it cannot be made."""
    return WORLDS[settings.world.name](settings)


def make_worlds(settings: PretrainConfig) -> list[World]:
    """The worlds of a pre-training: ``mazes`` names several mazes with one setting."""
    name, mazes = settings.world.name, settings.mazes
    require(not mazes or name == "maze", "mazes must be empty in other worlds", name)
    each = [replace(settings.maze, name=one) for one in mazes] or [settings.maze]
    return [make_world(replace(settings, maze=maze)) for maze in each]
