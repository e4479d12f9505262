"""What an engine must offer so that mazes can run on it, and how it fails."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from toponav.envs.layout import Layout
from toponav.envs.scene import Pose, Scene
from toponav.worlds import Motion, WorldSpec


class EngineError(RuntimeError):
    """The engine could not be started, or did something that it must not."""


class EngineLostError(EngineError):
    """A running engine died; a new one can take its place."""


@dataclass(frozen=True, kw_only=True)
class Look:
    """How a maze is decorated, as ``MazeEnv`` explains; engines draw what they can."""

    texture_seed: int = 0
    paintings: float = 0.5
    marks: float = 1.0

    def __post_init__(self) -> None:
        for name, share in (("paintings", self.paintings), ("marks", self.marks)):
            if not 0.0 <= share <= 1.0:
                raise ValueError(f"{name} must lie in [0, 1], got {share}")


@dataclass(frozen=True, kw_only=True)
class Camera:
    """The view's geometry, from which depth is computed.

    Heights are above the floor, in map units; ``tan_across`` and ``tan_down`` are the
    tangents of half the horizontal and half the vertical field of view.
    """

    eye_height: float
    wall_height: float
    tan_across: float
    tan_down: float


class Game(Protocol):
    """One maze on one engine: scenes go in, decisions come out.

    Threads use games, each game one thread at a time. Any method may raise
    ``EngineLostError``; ``restart`` is then called before the next ``reset``.

    Attributes:
        pixels: the view after the last decision, uint8 ``[H, W, 3]``, a new array.
        pose: where the agent stands.
        reward: reward of the last decision.
        respawned: whether the goal was touched in it; the agent then stands at (or on
            its way from) ``scene.next_start()``, and the episode continues.
        closed: letters of the slots that are closed now.
    """

    pixels: NDArray[np.uint8]
    pose: Pose
    reward: float
    respawned: bool
    closed: set[str]

    @property
    def pid(self) -> int:
        """Number of the process in which the engine runs, maybe this one."""

    def reset(self, scene: Scene) -> None:
        """Start an episode that is a function of the scene alone."""

    def step(self, action: int) -> None:
        """Take one decision; the action has been checked."""

    def check_slot(self, letter: str, *, closed: bool) -> None:
        """A ``ValueError`` if a slot is unknown, or would cut the maze in two."""

    def set_slot(self, letter: str, *, closed: bool) -> None:
        """Close or open a slot that was checked, when the agent is clear of it."""

    def restart(self) -> None:
        """Replace an engine that was lost."""

    def close(self) -> None:
        """End the engine; may be called twice."""


@dataclass(frozen=True, kw_only=True)
class GameEngine:
    """An engine as environments see it; its room holds one as ``ENGINE``.

    Args:
        world: its numbers; must have a ``motion``.
        camera: its view.
        start: starts a game of a maze, in a thread; an ``EngineError`` if it cannot.
        check: an ``EngineError`` where the engine is not installed or cannot run;
            recipes call it before they start anything.
        prepare: called once, before the first ``start``, in the caller's thread.
        end_strays: ends what engines of dead processes left; returns their number.
        shared_bytes: shared memory that a game takes.
    """

    world: WorldSpec
    camera: Camera
    start: Callable[[Layout, Look], Game]
    check: Callable[[], None] = lambda: None
    prepare: Callable[[Layout, Look], None] = lambda layout, look: None
    end_strays: Callable[[], int] = int
    shared_bytes: int = 0

    @property
    def motion(self) -> Motion:
        """What a decision does to a pose."""
        assert self.world.motion is not None
        return self.world.motion
