"""DeepMind Lab, an engine that its users install: level script and process."""

from toponav.envs.engines.dmlab.engine import check_installed
from toponav.envs.engines.dmlab.game import MazeGame
from toponav.envs.engines.dmlab.spec import CAMERA, WORLD
from toponav.envs.game import GameEngine

ENGINE = GameEngine(world=WORLD, camera=CAMERA, start=MazeGame, check=check_installed)
