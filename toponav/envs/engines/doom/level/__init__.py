"""From a layout to a level file that the engine loads."""

from toponav.envs.engines.doom.level.compile import compile_maze as compile_maze
from toponav.envs.engines.doom.level.udmf import slot_tag as slot_tag
from toponav.envs.engines.doom.level.wad import (
    check_wad as check_wad,
    wad_file as wad_file,
)
