"""Mazes on a real 3-D engine, as Gymnasium and TorchRL environments."""

from toponav.envs.doom.errors import EngineError, EngineLostError
from toponav.envs.gym_env import MazeEnv, register_mazes
from toponav.envs.layout import Layout, load_layout_file
from toponav.envs.layout_rules import LayoutError
from toponav.envs.maze_env import DoomMazeEnv
from toponav.envs.mazes import MAZES, load_maze, make_random_layout

__all__ = [
    "MAZES",
    "DoomMazeEnv",
    "EngineError",
    "EngineLostError",
    "Layout",
    "LayoutError",
    "MazeEnv",
    "load_layout_file",
    "load_maze",
    "make_random_layout",
]

register_mazes()
