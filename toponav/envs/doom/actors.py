"""The things of a maze in the engine's own definition language."""

#: Sprite names (four letters); the lumps carry frame and rotation, "A0".
APPLE_SPRITE = "MZAP"
GOAL_SPRITE = "MZGO"
SKY_TEXTURE = "MZSKY"

# The player walks 33.1 map units a decision without slipping: the factor halves
# its velocity each tic, so it stops within one decision. It has no weapon and
# cannot be hurt.
_PLAYER = """
ACTOR MazePlayer : PlayerPawn
{
  Speed 1  Health 100  Radius 16  Height 56  Mass 100
  Player.DisplayName "MazePlayer"
  Player.ViewHeight 48
  Player.ForwardMove 5.8
  +NODAMAGE +NOBLOOD -SOLID
  States
  {
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
  }
}
"""

_PICKUP = """
ACTOR {name} : CustomInventory
{{
  Radius 20  Height 40
  +INVENTORY.QUIET {flags}
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


def decorate(apple_script: int, goal_script: int) -> str:
    """The ``DECORATE`` lump: player, apple, goal.

    Args:
        apple_script: number of the script that runs when an apple is touched.
        goal_script: the same for the goal.
    """
    always = "+INVENTORY.ALWAYSPICKUP"
    apple = _PICKUP.format(
        name="MazeApple", sprite=APPLE_SPRITE, script=apple_script, flags=always
    )
    goal = _PICKUP.format(
        name="MazeGoal", sprite=GOAL_SPRITE, script=goal_script, flags=always
    )
    return _PLAYER + apple + goal


def zmapinfo(map_name: str) -> str:
    """The ``ZMAPINFO`` lump: our player class, our sky, even light."""
    return (
        'gameinfo { playerclasses = "MazePlayer" }\n'
        f'map {map_name} "maze" {{ sky1 = "{SKY_TEXTURE}", 0  levelnum = 1  '
        "evenlighting  nointermission }\n"
    )
