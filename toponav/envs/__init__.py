"""Mazes on 3-D engines and other pixel worlds, as TorchRL environments."""

from toponav.envs.engines import (
    DEFAULT_ENGINE as DEFAULT_ENGINE,
    ENGINES as ENGINES,
    end_stray_engines as end_stray_engines,
    load_engine as load_engine,
)
from toponav.envs.game import (
    EngineError as EngineError,
    EngineLostError as EngineLostError,
)
from toponav.envs.gym_env import (
    MazeGymEnv as MazeGymEnv,
    register_mazes as register_mazes,
)
from toponav.envs.gym_pictures import GymChoices as GymChoices
from toponav.envs.layout import (
    Layout as Layout,
    LayoutError as LayoutError,
    load_layout_file as load_layout_file,
)
from toponav.envs.maze_env import MazeEnv as MazeEnv
from toponav.envs.mazes import (
    MAZES as MAZES,
    load_maze as load_maze,
    make_random_layout as make_random_layout,
    unknown_name as unknown_name,
)
from toponav.envs.pixel_world import make_pixel_env as make_pixel_env
from toponav.envs.scene import SceneRules as SceneRules, draw_scene as draw_scene

register_mazes()
