"""An engine in plain NumPy: other views, actions and cells than the real one has."""

import math
import os

import numpy as np
from numpy.typing import NDArray

from toponav.envs import EngineError, EngineLostError, Layout
from toponav.envs.depth import DepthCaster
from toponav.envs.game import Camera, GameEngine, Look
from toponav.envs.scene import Pose, Scene
from toponav.worlds import Effect, Motion, WorldSpec

_CELL, _STEP, _TURN = 10.0, 2.5, 30.0
_RADIUS, _REACH = 1.0, 3.0
WORLD = WorldSpec(
    view_size=(24, 36),
    actions=("ahead", "left", "right"),
    motion=Motion(
        cell_size=_CELL,
        effects=(Effect(ahead=_STEP), Effect(turn=_TURN), Effect(turn=-_TURN)),
    ),
    goal_reward=5.0,
    apple_reward=0.5,
)
CAMERA = Camera(eye_height=4, wall_height=10, tan_across=1, tan_down=0.75)


class FakeGame:
    """A maze whose view is its depth, tinted by the heading and the look."""

    def __init__(self, layout: Layout, look: Look) -> None:
        self.layout, self._tint = layout, look.texture_seed
        self._caster = DepthCaster(
            layout, WORLD.view_size, camera=CAMERA, cell_size=_CELL
        )
        self.reward, self.respawned = 0.0, False
        self.closed: set[str] = set()
        self.is_dead = self.is_ended = False
        self.pid = os.getpid()

    def reset(self, scene: Scene) -> None:
        self._check_alive()
        self.scene, self.pose = scene, scene.start
        self.closed, self._apples = set(scene.blocked), list(scene.apples)
        self.reward, self.respawned = 0.0, False
        self._draw()

    def step(self, action: int) -> None:
        self._check_alive()
        turn = (0.0, _TURN, -_TURN)[action]
        x, y, heading = self.pose
        heading = (heading + turn) % 360.0
        if action == 0:
            angle = math.radians(heading)
            ahead = x + _STEP * math.cos(angle), y + _STEP * math.sin(angle)
            x, y = ahead if self._is_free(*ahead) else (x, y)
        self.pose = Pose(x, y, heading)
        left = [apple for apple in self._apples if math.dist(apple, (x, y)) > _REACH]
        self.reward = 0.5 * (len(self._apples) - len(left))
        self._apples = left
        goal = self.scene.goal
        self.respawned = goal is not None and math.dist(goal, (x, y)) <= _REACH
        if self.respawned:
            self.reward += 5.0
            self.pose = self.scene.next_start()
        self._draw()

    def check_slot(self, letter: str, *, closed: bool) -> None:
        self.layout.check_slots({*self.closed, letter} if closed else {letter})

    def set_slot(self, letter: str, *, closed: bool) -> None:
        self._check_alive()
        if closed:
            self.closed.add(letter)
        else:
            self.closed.discard(letter)

    def restart(self) -> None:
        self.is_dead = False

    def close(self) -> None:
        self.is_ended = True

    def _check_alive(self) -> None:
        if self.is_dead:
            raise EngineLostError("the fake died")

    def _is_free(self, x: float, y: float) -> bool:
        corners = [
            self.layout.cell_of(x + dx, y + dy, _CELL)
            for dx in (-_RADIUS, _RADIUS)
            for dy in (-_RADIUS, _RADIUS)
        ]
        walls = {self.layout.slots[letter] for letter in self.closed}
        return all(
            self.layout.open_mask[corner] and corner not in walls for corner in corners
        )

    def _draw(self) -> None:
        closed = np.array([[slot in self.closed for slot in self.layout.slots]])
        x, y, heading = (np.array([number]) for number in self.pose)
        depth = self._caster.cast(x, y, heading, closed)[0] / self._caster.far
        tint = np.array([1.0, self.pose.heading / 360.0, self._tint % 7 / 7.0])
        view: NDArray[np.uint8] = (depth[..., None] * tint * 255).astype(np.uint8)
        self.pixels = view


def missing(layout: Layout, look: Look) -> FakeGame:
    """What an engine does that is not installed."""
    raise EngineError("the fake engine must be installed, and it is not: buy one")


#: Started games, for tests that kill one.
GAMES: list[FakeGame] = []


def start(layout: Layout, look: Look) -> FakeGame:
    GAMES.append(FakeGame(layout, look))
    return GAMES[-1]


ENGINE = GameEngine(world=WORLD, camera=CAMERA, start=start)
