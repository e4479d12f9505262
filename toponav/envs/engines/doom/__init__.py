"""The ViZDoom engine: art, level compiler, scripts, process handling."""

from toponav.envs.engines.doom.game import MazeGame as MazeGame, prepare
from toponav.envs.engines.doom.instances import check_room, sweep
from toponav.envs.engines.doom.shared_memory import SHARED_BYTES
from toponav.envs.engines.doom.spec import (
    ACTIONS as ACTIONS,
    CAMERA,
    TICS_PER_DECISION as TICS_PER_DECISION,
    WORLD as WORLD,
)
from toponav.envs.game import GameEngine

ENGINE = GameEngine(
    world=WORLD,
    camera=CAMERA,
    start=MazeGame,
    check=check_room,
    prepare=prepare,
    end_strays=sweep,
    shared_bytes=SHARED_BYTES,
)
