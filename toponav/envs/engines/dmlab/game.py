"""One maze on one engine: scenes go in, decisions come out."""

import math

import numpy as np
from numpy.typing import NDArray

from toponav.envs.engines.dmlab.engine import Engine, Seen
from toponav.envs.engines.dmlab.spec import (
    ACTIONS,
    FRAMES_PER_DECISION,
    GOAL_REWARD,
)
from toponav.envs.engines.dmlab.text_level import level_settings, pose_text, scene_text
from toponav.envs.game import EngineError, Look
from toponav.envs.layout import Layout
from toponav.envs.scene import Pose, Scene

# Look to the right, look down, strafe, move, fire, jump, crouch.
_HELD = [[right, 0, 0, move, 0, 0, 0] for (move, right), _ in ACTIONS.values()]
_NOTHING = [0] * 7
# For so long an agent that was put somewhere stands in the engine's glow.
_SETTLING_FRAMES = 36


class MazeGame:
    """Plays episodes of one maze on DeepMind Lab; see `toponav.envs.game.Game`."""

    pixels: NDArray[np.uint8]
    pose: Pose
    scene: Scene

    def __init__(self, layout: Layout, look: Look = Look()) -> None:  # noqa: B008
        self.layout, self._settings = layout, level_settings(layout, look)
        self.engine = Engine(self._settings)
        self.reward = 0.0
        self.respawned = False
        self.closed: set[str] = set()

    def reset(self, scene: Scene) -> None:
        """Start an episode; an ``EngineError`` if the agent does not stand there."""
        self.scene, self.closed = scene, set(scene.blocked)
        text = scene_text(self.layout, self._settings, scene)
        self._see(self.engine.reset(text, idle=_SETTLING_FRAMES))
        self.reward, self.respawned = 0.0, False
        self._check_start(scene.start)
        self._send_respawn()

    def step(self, action: int) -> None:
        """Take one decision: hold an action for its frames, or up to the goal."""
        goal = None if self.scene.goal is None else GOAL_REWARD
        self.reward, seen = self.engine.act(
            _HELD[action], frames=FRAMES_PER_DECISION, least=goal
        )
        self.respawned = goal is not None and self.reward >= GOAL_REWARD
        if self.respawned:
            # The engine puts the agent there in the next frame, where an apple may be.
            more, seen = self.engine.act(_NOTHING, frames=_SETTLING_FRAMES)
            self.reward += more
        self._see(seen)
        if self.respawned:
            self._send_respawn()

    def check_slot(self, letter: str, *, closed: bool) -> None:
        self.layout.check_slots({*self.closed, letter} if closed else {letter})

    def set_slot(self, letter: str, *, closed: bool) -> None:
        """Refused unless the slot is so already: maps cannot change while they run."""
        if closed != (letter in self.closed):
            raise EngineError(
                "slots must stay as they are while an episode runs on engine=dmlab, "
                "whose maps are compiled: close them for whole episodes by "
                f"maze.blocked, or use engine=vizdoom; got '{letter}'"
            )

    @property
    def pid(self) -> int:
        return self.engine.pid

    def restart(self) -> None:
        self.engine.restart()

    def close(self) -> None:
        self.engine.close()

    def _see(self, seen: Seen) -> None:
        self.pixels, (x, y, yaw) = seen
        self.pose = Pose(x, y, yaw % 360.0)

    def _check_start(self, start: Pose) -> None:
        if math.dist(self.pose[:2], start[:2]) > 1.0:
            places = f"{start}, the engine put it at {self.pose}"
            raise EngineError(f"the agent must start at {places}")

    def _send_respawn(self) -> None:
        if self.scene.goal is not None:
            self.engine.set_respawn(pose_text(self.scene.next_start()))
