"""The numbers of the mazes on DeepMind Lab; nobody else holds them."""

import math

from toponav.envs.game import Camera
from toponav.worlds import Effect, Motion, WorldSpec

FRAMES_PER_SECOND, FRAMES_PER_DECISION = 60, 4
#: Map units of a cell's side, which are the engine's own, and of a decision forward at
#: full speed.
CELL_SIZE = 100
STEP_LENGTH = 20.8
#: The look rate of the literature's agents, in the engine's pixels a frame, and what a
#: pixel turns by in a frame, in degrees.
PIXELS = 20
PIXEL_ANGLE = 0.1056
GOAL_REWARD, APPLE_REWARD = 10.0, 1.0

TURN_ANGLE = PIXELS * PIXEL_ANGLE * FRAMES_PER_DECISION
#: The six actions in the paper's order, and what they hold for all frames of a
#: decision: forward or backward, pixels a frame to the right.
ACTIONS = {
    "forward": (1, 0),
    "backward": (-1, 0),
    "left": (0, -PIXELS),
    "right": (0, PIXELS),
    "forward+left": (1, -PIXELS),
    "forward+right": (1, PIXELS),
}


def _effect(forward: int, right: int) -> Effect:
    # In each frame the agent turns first and then moves: its path is an arc, whose
    # chord points aside by so much of the turn.
    turn = -math.copysign(TURN_ANGLE, right) if right else 0.0
    chord = math.radians((FRAMES_PER_DECISION + 1) / (2 * FRAMES_PER_DECISION) * turn)
    step = STEP_LENGTH * forward
    return Effect(step * math.cos(chord), step * math.sin(chord), turn)


WORLD = WorldSpec(
    view_size=(120, 160),
    actions=tuple(ACTIONS),
    motion=Motion(
        cell_size=CELL_SIZE,
        effects=tuple(_effect(*held) for held in ACTIONS.values()),
    ),
    goal_reward=GOAL_REWARD,
    apple_reward=APPLE_REWARD,
)
#: 90 degrees across, square pixels.
CAMERA = Camera(eye_height=50, wall_height=100, tan_across=1.0, tan_down=0.75)
