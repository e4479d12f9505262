"""The numbers of the mazes on DeepMind Lab; nobody else holds them."""

from toponav.envs.game import Camera
from toponav.worlds import Effect, Motion, WorldSpec

FRAMES_PER_SECOND, FRAMES_PER_DECISION = 60, 4
#: Map units of a cell's side, which are the engine's own, and of a decision forward at
#: full speed: 320 a second, of which four frames are 64 ms to the engine, so that it
#: is 20.8 and 19.84 in turns.
CELL_SIZE = 100
STEP_LENGTH = 20.48
#: The look rate of the literature's agents, in the engine's pixels a frame, and what
#: they turn by in a decision, in degrees.
PIXELS = 20
TURN_ANGLE = 8.448
#: A decision of walking and turning at full speed, in the agent's frame before it. The
#: agent glides on where it was going, away from where it turns to.
ARC_AHEAD, ARC_ASIDE = 20.8, 2.5
#: The agent is a square of twice this side, in map units.
PLAYER_RADIUS = 16
GOAL_REWARD, APPLE_REWARD = 10.0, 1.0

#: The six actions in the paper's order: what they hold for all frames of a decision
#: (forward or backward, pixels a frame to the right), and where that leads.
ACTIONS = {
    "forward": ((1, 0), Effect(STEP_LENGTH)),
    "backward": ((-1, 0), Effect(-STEP_LENGTH)),
    "left": ((0, -PIXELS), Effect(turn=TURN_ANGLE)),
    "right": ((0, PIXELS), Effect(turn=-TURN_ANGLE)),
    "forward+left": ((1, -PIXELS), Effect(ARC_AHEAD, -ARC_ASIDE, TURN_ANGLE)),
    "forward+right": ((1, PIXELS), Effect(ARC_AHEAD, ARC_ASIDE, -TURN_ANGLE)),
}

WORLD = WorldSpec(
    engine="dmlab",
    view_size=(120, 160),
    actions=tuple(ACTIONS),
    motion=Motion(
        cell_size=CELL_SIZE,
        effects=tuple(effect for _, effect in ACTIONS.values()),
    ),
    goal_reward=GOAL_REWARD,
    apple_reward=APPLE_REWARD,
)
#: 90 degrees across, square pixels.
CAMERA = Camera(eye_height=51, wall_height=100, tan_across=1.0, tan_down=0.75)
