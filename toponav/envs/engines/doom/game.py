"""One maze on one engine: scenes go in, decisions come out."""

import math

import numpy as np
from numpy.typing import NDArray

from toponav.envs.engines.doom import instances
from toponav.envs.engines.doom.engine import Engine, fixed, turn
from toponav.envs.engines.doom.level import acs, compile_maze, slot_tag, wad_file
from toponav.envs.engines.doom.spec import (
    ACTIONS,
    APPLE_REWARD,
    CELL_SIZE,
    GOAL_REWARD,
    PLAYER_RADIUS,
    STEP_LENGTH,
    TICS_PER_DECISION,
)
from toponav.envs.game import EngineError, Look
from toponav.envs.layout import Layout
from toponav.envs.scene import Pose, Scene

_BUTTONS = tuple(list(buttons) for buttons in ACTIONS.values())
_NO_BUTTONS = [0.0, 0.0, 0.0]
# A slot closes at this distance: scripts run after the tic's move, so the agent comes
# one tic nearer.
_CLEAR = CELL_SIZE / 2 + PLAYER_RADIUS + STEP_LENGTH / TICS_PER_DECISION + 1


def prepare(layout: Layout, look: Look) -> None:
    """Compile a maze once, before all games ask for it at the same time."""
    compile_maze(layout, look)
    # Here, because the games' threads must not touch signals.
    instances.end_engines_on_sigterm()


class MazeGame:
    """Plays episodes of one maze on ViZDoom; see `toponav.envs.game.Game`.

    ``inspect`` is that of ``Engine``.
    """

    pixels: NDArray[np.uint8]
    pose: Pose
    scene: Scene

    def __init__(
        self,
        layout: Layout,
        look: Look = Look(),  # noqa: B008 (immutable)
        *,
        inspect: bool = False,
    ) -> None:
        self.layout = layout
        wad, map_name = compile_maze(layout, look)
        self.engine = Engine(wad_file(wad), map_name, inspect=inspect)
        self.reward = 0.0
        self.respawned = False
        self.closed: set[str] = set()
        self._to_close: set[str] = set()
        self._apples = self._goals = 0.0

    def reset(self, scene: Scene) -> None:
        """Start an episode; an ``EngineError`` if the agent does not stand there."""
        self.scene = scene
        self.engine.new_episode()
        self.closed, self._to_close = set(scene.blocked), set()
        for letter in scene.blocked:
            self._move_slot(acs.CLOSE_SLOT, letter)
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
            places = f"{scene.start}, the engine put it at {self.pose}"
            raise EngineError(f"the agent must start at {places}")

    def place(self, pose: Pose) -> None:
        """Put the agent at a pose; costs one engine tic, not a decision."""
        self.engine.run_script(acs.PLACE_PLAYER, *_script_pose(pose))
        self.engine.act(_NO_BUTTONS, tics=1)
        self._observe()

    def step(self, action: int) -> None:
        """Take one decision: hold an action's buttons for its tics."""
        for letter in sorted(self._to_close):
            x, y = self.layout.centre(self.layout.slots[letter], CELL_SIZE)
            if max(abs(self.pose.x - x), abs(self.pose.y - y)) >= _CLEAR:
                self._to_close.remove(letter)
                self.closed.add(letter)
                self._move_slot(acs.CLOSE_SLOT, letter)
        self.engine.act(_BUTTONS[action])
        apples, goals = self._observe()
        self.reward = APPLE_REWARD * (apples - self._apples)
        self.respawned = goals != self._goals
        if self.respawned:
            self.reward += GOAL_REWARD * (goals - self._goals)
            self._send_respawn()
        self._apples, self._goals = apples, goals

    def check_slot(self, letter: str, *, closed: bool) -> None:
        others = {*self.closed, *self._to_close} if closed else set[str]()
        self.layout.check_slots({*others, letter})

    def set_slot(self, letter: str, *, closed: bool) -> None:
        if closed:  # later: a rising floor would lift the agent over the walls
            if letter not in self.closed:
                self._to_close.add(letter)
            return
        self._to_close.discard(letter)
        if letter in self.closed:
            self.closed.remove(letter)
            self._move_slot(acs.OPEN_SLOT, letter)

    @property
    def pid(self) -> int:
        return self.engine.pid

    def restart(self) -> None:
        self.engine.restart()

    def close(self) -> None:
        self.engine.close()

    def _observe(self) -> tuple[float, float]:
        self.pixels, variables = self.engine.observe()
        x, y, heading, apples, goals = variables.tolist()
        self.pose = Pose(x, y, heading)
        return apples, goals

    def _send_respawn(self) -> None:
        self.engine.run_script(acs.SET_RESPAWN, *_script_pose(self.scene.next_start()))

    def _move_slot(self, script: int, letter: str) -> None:
        self.engine.run_script(script, slot_tag(self.layout, letter))


def _script_pose(pose: Pose) -> tuple[int, int, int]:
    return fixed(pose.x), fixed(pose.y), turn(pose.heading)
