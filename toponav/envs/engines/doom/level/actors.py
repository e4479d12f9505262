"""The things of a maze in the engine's own definition language."""

from toponav.envs.engines.doom.level import acs
from toponav.envs.engines.doom.spec import EYE_HEIGHT, PLAYER_RADIUS

#: Sprite names (four letters); the lumps carry frame and rotation, "A0".
APPLE_SPRITE = "MZAP"
GOAL_SPRITE = "MZGO"
SKY_TEXTURE = "MZSKY"

# The player moves `STEP_LENGTH` a decision without slipping: the factor halves its
# speed each tic, so it stops within one decision. It has no weapon, nothing hurts it.
_PLAYER = f"""
ACTOR MazePlayer : PlayerPawn
{{
  Speed 1  Health 100  Radius {PLAYER_RADIUS}  Height 56  Mass 100
  Player.DisplayName "MazePlayer"
  Player.ViewHeight {EYE_HEIGHT}
  Player.ForwardMove 5.8
  +NODAMAGE +NOBLOOD -SOLID
  States
  {{
  Spawn: TNT1 A 1 A_ScaleVelocity(0.5)
    Loop
  See: TNT1 A 1 A_ScaleVelocity(0.5)
    Loop
  Missile: TNT1 A -1
    Loop
  Pain: TNT1 A 4
    Goto Spawn
  Death: TNT1 A -1
    Stop
  }}
}}
"""


def _pickup(name: str, sprite: str, script: int) -> str:
    return f"""
ACTOR {name} : CustomInventory
{{
  Radius 20  Height 40
  +INVENTORY.QUIET +INVENTORY.ALWAYSPICKUP
  Inventory.PickupMessage ""
  Inventory.PickupSound ""
  States
  {{
  Spawn: {sprite} A -1 Bright
    Stop
  Pickup: TNT1 A 0 ACS_ExecuteAlways({script}, 0)
    Stop
  }}
}}
"""


def decorate() -> str:
    """The ``DECORATE`` lump: player, apple, goal."""
    apple = _pickup("MazeApple", APPLE_SPRITE, acs.APPLE_TOUCHED)
    return _PLAYER + apple + _pickup("MazeGoal", GOAL_SPRITE, acs.GOAL_TOUCHED)


def zmapinfo(map_name: str) -> str:
    """The ``ZMAPINFO`` lump: our player class, our sky, even light."""
    return (
        'gameinfo { playerclasses = "MazePlayer" }\n'
        f'map {map_name} "maze" {{ sky1 = "{SKY_TEXTURE}", 0  levelnum = 1  '
        "evenlighting  nointermission }\n"
    )
