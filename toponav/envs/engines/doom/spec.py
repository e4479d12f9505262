"""The numbers of the mazes on ViZDoom; nobody else holds them."""

import math

from toponav.envs.game import Camera
from toponav.worlds import Effect, Motion, WorldSpec

TICS_PER_DECISION = 4
#: Map units of a cell's side, of a decision forward at full speed (the first one after
#: a stop has 22.6), and of the walls' height, to which a closed slot's floor rises.
CELL_SIZE = 128
STEP_LENGTH = 33.1
ROOM_HEIGHT = 128
#: Degrees that one turning decision asks for, and the parts of a turn that the engine
#: counts in.
TURN_ANGLE = 20.0
TURN_PARTS = 2**16
#: The agent is a square of twice this side, in map units; its eye is so high.
PLAYER_RADIUS = 16
EYE_HEIGHT = 48
GOAL_REWARD, APPLE_REWARD = 10.0, 1.0

_TURN_PER_TIC = TURN_ANGLE / TICS_PER_DECISION
#: The six actions in the paper's order, and what they hold for all tics of a decision:
#: forward, backward, degrees per tic to the right.
ACTIONS = {
    "forward": (1.0, 0.0, 0.0),
    "backward": (0.0, 1.0, 0.0),
    "left": (0.0, 0.0, -_TURN_PER_TIC),
    "right": (0.0, 0.0, _TURN_PER_TIC),
    "forward+left": (1.0, 0.0, -_TURN_PER_TIC),
    "forward+right": (1.0, 0.0, _TURN_PER_TIC),
}


def _effect(forward: float, backward: float, right: float) -> Effect:
    # In each tic the agent turns first and then moves: its path is an arc, whose chord
    # points aside by so much of the turn.
    # Each tic is rounded down to whole parts: 20.017 degrees to the left and 19.995 to
    # the right. An agent that explores is off by 14 degrees after 1,800 decisions
    # where both count as 20.
    parts = -math.floor(right / 360 * TURN_PARTS)
    turn = parts / TURN_PARTS * 360 * TICS_PER_DECISION
    chord = math.radians((TICS_PER_DECISION + 1) / (2 * TICS_PER_DECISION) * turn)
    step = STEP_LENGTH * (forward - backward)
    return Effect(step * math.cos(chord), step * math.sin(chord), turn)


WORLD = WorldSpec(
    engine="vizdoom",
    view_size=(120, 160),
    actions=tuple(ACTIONS),
    motion=Motion(
        cell_size=CELL_SIZE,
        effects=tuple(_effect(*held) for held in ACTIONS.values()),
    ),
    goal_reward=GOAL_REWARD,
    apple_reward=APPLE_REWARD,
)
#: 90 degrees across; down, 60 pixels at a focal length of 96, since the engine's pixels
#: are 1.2 times as high as wide.
CAMERA = Camera(
    eye_height=EYE_HEIGHT,
    wall_height=ROOM_HEIGHT,
    tan_across=1.0,
    tan_down=60.0 / 96.0,
)
