"""One maze on one engine: scenes go in, decisions come out."""

import math

import numpy as np
from numpy.typing import NDArray

from toponav.envs.doom import acs
from toponav.envs.doom.compile import compile_maze
from toponav.envs.doom.engine import ACTION_REPEAT, Engine, fixed, turn
from toponav.envs.doom.errors import EngineError
from toponav.envs.doom.udmf import slot_tag
from toponav.envs.doom.wad_cache import wad_file
from toponav.envs.layout import CELL_SIZE, Layout
from toponav.envs.scene import Pose, Scene

#: Degrees that one turning decision turns by.
TURN_ANGLE = 20.0
#: Map units of one decision forward at full speed (the first has 22.6).
STEP_LENGTH = 33.1
#: The agent is a square of twice this side, in map units.
PLAYER_RADIUS = 16
#: The six actions in the paper's order, and the buttons they hold for four tics:
#: forward, backward, degrees per tic to the right.
ACTIONS = {
    "forward": (1.0, 0.0, 0.0),
    "backward": (0.0, 1.0, 0.0),
    "left": (0.0, 0.0, -5.0),
    "right": (0.0, 0.0, 5.0),
    "forward+left": (1.0, 0.0, -5.0),
    "forward+right": (1.0, 0.0, 5.0),
}
NUM_ACTIONS = len(ACTIONS)
APPLE_REWARD = 1.0
GOAL_REWARD = 10.0

_BUTTONS = tuple(list(buttons) for buttons in ACTIONS.values())
_NO_BUTTONS = [0.0, 0.0, 0.0]


class MazeGame:
    """Plays episodes of one maze; holds what the last decision left behind.

    Args:
        layout: the maze.
        texture_seed: draws its walls, floors and paintings.
        paintings: share of wall edges with a painting, in [0, 1].
        marks: share of wall edges with small marks of their own, in [0, 1].
        depth_buffer: keep the engine's own depth picture (tests).
        objects: keep the engine's list of things (tests).

    Attributes:
        pixels: uint8 ``[120, 160, 3]``, the view after the last decision.
        pose: where the agent stands.
        reward: reward of the last decision.
        respawned: whether the goal was touched in it.
        closed: letters of the slots that are closed now.

    Raises:
        EngineError: if the engine is not installed or cannot load the maze.
    """

    pixels: NDArray[np.uint8]
    pose: Pose
    scene: Scene

    def __init__(
        self,
        layout: Layout,
        *,
        texture_seed: int = 0,
        paintings: float = 0.5,
        marks: float = 1.0,
        depth_buffer: bool = False,
        objects: bool = False,
    ) -> None:
        self.layout = layout
        maze = compile_maze(
            layout, texture_seed=texture_seed, paintings=paintings, marks=marks
        )
        self.engine = Engine(
            wad_file(maze), maze.map_name, depth_buffer=depth_buffer, objects=objects
        )
        self.reward = 0.0
        self.respawned = False
        self.closed: set[str] = set()
        self._to_close: set[str] = set()
        self._apples = self._goals = 0.0

    def reset(self, scene: Scene) -> None:
        """Start an episode.

        Raises:
            EngineLostError: if the engine died.
            EngineError: if the agent does not stand where the scene says.
        """
        self.scene = scene
        self.engine.new_episode()
        self.closed = set(scene.blocked)
        self._to_close = set()
        for letter in scene.blocked:
            self.engine.run_script(acs.CLOSE_SLOT, slot_tag(self.layout, letter))
        for number, (x, y) in enumerate(scene.apples):
            apple = (fixed(x), fixed(y), acs.APPLE_TID + number)
            self.engine.run_script(acs.SPAWN_APPLE, *apple)
        if scene.goal is not None:
            x, y = scene.goal
            self.engine.run_script(acs.SPAWN_GOAL, fixed(x), fixed(y))
            self._send_respawn()
        self.place(scene.start)
        self._apples = self._goals = self.reward = 0.0
        self.respawned = False
        if math.dist(self.pose[:2], scene.start[:2]) > 1.0:
            raise EngineError(
                f"the agent must start at {scene.start}, the engine put it at "
                f"{self.pose}"
            )

    def place(self, pose: Pose) -> None:
        """Put the agent at a pose; costs one engine tic, not a decision."""
        self.engine.run_script(
            acs.PLACE_PLAYER, fixed(pose.x), fixed(pose.y), turn(pose.heading)
        )
        self.engine.act(_NO_BUTTONS, tics=1)
        self._observe()

    def step(self, action: int) -> None:
        """Take one decision: hold an action's buttons for four tics.

        Args:
            action: index into ``ACTIONS``.

        Raises:
            ValueError: if there is no such action.
            EngineLostError: if the engine died.
        """
        if not 0 <= action < NUM_ACTIONS:
            raise ValueError(f"action must be in [0, {NUM_ACTIONS}), got {action}")
        if self._to_close:
            self._close_clear_slots()
        self.engine.act(_BUTTONS[action])
        apples, goals = self._observe()
        self.reward = APPLE_REWARD * (apples - self._apples)
        self.respawned = goals != self._goals
        if self.respawned:
            self.reward += GOAL_REWARD * (goals - self._goals)
            self._send_respawn()
        self._apples, self._goals = apples, goals

    def set_slot(self, letter: str, *, closed: bool) -> None:
        """Close or open a slot; takes effect with the next decision.

        A slot closes only when the agent is clear of its cell (a rising floor
        would lift the agent over the walls); until then the closing waits.

        Raises:
            ValueError: if the slot is unknown or would cut the maze in two.
        """
        if closed:
            self.layout.check_slots({*self.closed, *self._to_close, letter})
            if letter not in self.closed:
                self._to_close.add(letter)
            return
        self.layout.check_slots({letter})
        self._to_close.discard(letter)
        if letter in self.closed:
            self.closed.remove(letter)
            self.engine.run_script(acs.OPEN_SLOT, slot_tag(self.layout, letter))

    def close(self) -> None:
        """End the engine."""
        self.engine.close()

    def _observe(self) -> tuple[float, float]:
        self.pixels, variables = self.engine.observe()
        x, y, heading, _, _, apples, goals = variables.tolist()
        self.pose = Pose(x, y, heading)
        return apples, goals

    def _send_respawn(self) -> None:
        pose = self.scene.next_start()
        self.engine.run_script(
            acs.SET_RESPAWN, fixed(pose.x), fixed(pose.y), turn(pose.heading)
        )

    def _close_clear_slots(self) -> None:
        # Scripts run after the tic's move, so the agent comes one tic nearer.
        reach = CELL_SIZE / 2 + PLAYER_RADIUS + STEP_LENGTH / ACTION_REPEAT + 1
        for letter in sorted(self._to_close):
            x, y = self.layout.centre(self.layout.slots[letter])
            if max(abs(self.pose.x - x), abs(self.pose.y - y)) >= reach:
                self._to_close.remove(letter)
                self.closed.add(letter)
                self.engine.run_script(acs.CLOSE_SLOT, slot_tag(self.layout, letter))
