"""Many mazes on many engines in one process, in lock step."""

import os
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from toponav.envs.errors import EngineError, EngineLostError
from toponav.envs.game import Game, GameEngine, Look
from toponav.envs.layout import Layout
from toponav.envs.lockstep_thread_pool import LockstepThreadPool
from toponav.envs.scene import Pose, Scene, SceneRules, draw_scene
from toponav.envs.specs import episode_streams

# Threads wait for engines, not for the processor: more than cores are of use.
_MOST_THREADS = 8


@dataclass
class Snapshot:
    """What all mazes show after a step or a reset; the arrays are the caller's.

    ``pixels`` is ``[E, H, W, 3]``, the others are ``[E]``; ``truncated``: the clock ran
    out or the engine was lost.
    """

    pixels: NDArray[np.uint8]
    reward: NDArray[np.float32]
    truncated: NDArray[np.bool_]


class BatchedGames:
    """E (``size``) games of one maze; a lost engine costs its own episode only.

    ``MazeEnv`` explains the arguments and what they raise.
    """

    def __init__(
        self,
        engine: GameEngine,
        layout: Layout,
        size: int,
        *,
        rules: SceneRules,
        episode_length: int,
        look: Look = Look(),  # noqa: B008 (immutable)
        num_threads: int | None = None,
    ) -> None:
        rules.check(layout)
        if episode_length < 1:
            raise ValueError(f"episode_length must be at least 1, got {episode_length}")
        self.engine = engine
        self.size = size
        self._process = os.getpid()
        self._layout = layout
        cell_size = engine.motion.cell_size
        self._draw_scene = partial(draw_scene, layout, rules, cell_size=cell_size)
        self._episode_length = episode_length
        self._threads = LockstepThreadPool(
            min(size, _MOST_THREADS) if num_threads is None else num_threads
        )
        self._games: list[Game] = []
        self._scenes: dict[int, Scene] = {}
        self._lost = np.zeros(size, dtype=bool)
        self._decisions = np.zeros(size, dtype=np.int64)
        # Poses after the last decision and before it.
        self._poses: list[Pose] = [Pose(0.0, 0.0, 0.0)] * size
        self._moves_from: list[Pose] = list(self._poses)
        self._pixels = np.zeros((size, *engine.world.view_size, 3), dtype=np.uint8)
        self.seed(0)

        def start(_: int) -> None:
            self._games.append(engine.start(layout, look))

        try:
            engine.prepare(layout, look)
            self._threads.run(start, range(size))
        except BaseException:
            self.close()
            raise

    def seed(self, seed: int | None) -> None:
        """Begin new streams of episodes, one a row; ``None`` draws a seed."""
        self._streams = episode_streams(seed, self.size)

    def reset(self, rows: Sequence[int]) -> Snapshot:
        """Begin a new episode in some rows; the others stay as they are."""
        self._check_process()
        self._pixels = self._pixels.copy()
        self._threads.run(self._reset_row, rows)
        self._decisions[list(rows)] = 0
        return self._snapshot(np.zeros(self.size, dtype=np.float32))

    def step(
        self, actions: Sequence[int], rows: Sequence[int] | None = None
    ) -> Snapshot:
        """Take one decision in some rows (all by default), of the E actions given.

        A ``ValueError`` if there is no such action; no row has then stepped.
        """
        self._check_process()
        rows = range(self.size) if rows is None else rows
        num_actions = self.engine.world.num_actions
        for row in rows:
            if not 0 <= actions[row] < num_actions:
                raise ValueError(
                    f"action must be in [0, {num_actions}), got {actions[row]}"
                )
        self._pixels = self._pixels.copy()
        self._decisions[list(rows)] += 1
        reward = np.zeros(self.size, dtype=np.float32)

        def step_row(row: int) -> None:
            reward[row] = self._step_row(row, actions[row])

        self._threads.run(step_row, rows)
        return self._snapshot(reward)

    def poses(self) -> NDArray[np.float64]:
        """Where the agents stand: x, y, heading, ``[E, 3]``."""
        return np.array(self._poses)

    def cells(self) -> NDArray[np.int64]:
        """Row and column of the cells in which they stand, ``[E, 2]``."""
        x, y, _ = self.poses().T
        return self._layout.cells_of(x, y, self.engine.motion.cell_size)

    def moves(self) -> NDArray[np.float64]:
        """How the agents moved in the last decision, in their own frame, ``[E, 3]``.

        Forward and left in map units, then the turn in degrees, counter-clockwise; zero
        after a reset or a respawn.
        """
        before, after = np.array(self._moves_from), np.array(self._poses)
        dx, dy, turned = (after - before).T
        angle = np.deg2rad(before[:, 2])
        forward = dx * np.cos(angle) + dy * np.sin(angle)
        left = dy * np.cos(angle) - dx * np.sin(angle)
        return np.stack([forward, left, (turned + 180.0) % 360.0 - 180.0], axis=1)

    def closed(self) -> NDArray[np.bool_]:
        """Which slots are closed, ``[E, S]``, in the layout's order."""
        slots = list(self._layout.slots)
        closed = [[slot in game.closed for slot in slots] for game in self._games]
        return np.array(closed, dtype=bool).reshape(self.size, len(slots))

    def goal_cells(self) -> NDArray[np.int64]:
        """Row and column of the goals, ``[E, 2]``, -1 without one."""
        cells = [scene.goal_cell or (-1, -1) for scene in self.scenes]
        return np.array(cells, dtype=np.int64)

    def respawned(self) -> NDArray[np.bool_]:
        """Whether the goal was touched in the last decision, ``[E]``."""
        return np.array([game.respawned for game in self._games])

    def set_slot(
        self, letter: str, *, closed: bool, rows: Iterable[int] | None = None
    ) -> None:
        """Close or open a slot in some rows (all by default)."""
        for row in range(self.size) if rows is None else rows:
            # The next step warns of a lost engine, and a reset replaces it.
            with suppress(EngineLostError):
                self._games[row].set_slot(letter, closed=closed)

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """What the current episode of each row holds."""
        return tuple(self._scenes[row] for row in range(self.size))

    @property
    def pids(self) -> tuple[int, ...]:
        """Process numbers of the engines."""
        return tuple(game.pid for game in self._games)

    def close(self) -> None:
        """End all engines."""
        self._threads.close()
        for game in self._games:
            game.close()

    def _check_process(self) -> None:
        # A fork has no copies of the pool's threads and would never return.
        if os.getpid() != self._process:
            raise EngineError(
                "a forked process must make mazes of its own, got its parent's"
            )

    def _snapshot(self, reward: NDArray[np.float32]) -> Snapshot:
        truncated = self._lost | (self._decisions >= self._episode_length)
        return Snapshot(pixels=self._pixels, reward=reward, truncated=truncated)

    def _reset_row(self, row: int) -> None:
        game = self._games[row]
        seed = int(self._streams[row].integers(2**63))

        def begin() -> None:
            # Drawn again on a second try, so that the episode is the same.
            self._scenes[row] = self._draw_scene(np.random.default_rng(seed))
            game.reset(self._scenes[row])

        try:
            if self._lost[row]:
                game.restart()
            begin()
        except EngineLostError as error:
            _warn(row, error)
            game.restart()
            begin()
        self._lost[row] = False
        self._poses[row] = self._moves_from[row] = game.pose
        self._pixels[row] = game.pixels

    def _step_row(self, row: int, action: int) -> float:
        game = self._games[row]
        if not self._lost[row]:
            try:
                game.step(action)
            except EngineLostError as error:
                self._lost[row] = True
                _warn(row, error)
        self._pixels[row] = game.pixels
        if self._lost[row]:
            self._moves_from[row] = game.pose
            return 0.0
        self._moves_from[row] = game.pose if game.respawned else self._poses[row]
        self._poses[row] = game.pose
        return game.reward


def _warn(row: int, error: EngineLostError) -> None:
    warnings.warn(
        f"maze {row} of the batch lost its engine and gets a new one; its episode is "
        f"truncated ({error})",
        RuntimeWarning,
        stacklevel=2,
    )
