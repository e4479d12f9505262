"""Many mazes on many engines in one process, in lock step."""

import os
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toponav.envs.doom import instances
from toponav.envs.doom.compile import compile_maze
from toponav.envs.doom.crew import Crew
from toponav.envs.doom.engine import HEIGHT, WIDTH
from toponav.envs.doom.errors import EngineError, EngineLostError
from toponav.envs.doom.game import MazeGame
from toponav.envs.layout import Layout
from toponav.envs.scene import Pose, Scene, SceneRules, draw_scene

# Threads wait for engines, not for the processor: more than cores are of use.
_MOST_THREADS = 8


@dataclass
class Snapshot:
    """What all mazes show after a step or a reset; the arrays are the caller's.

    Args:
        pixels: uint8 ``[E, 120, 160, 3]``.
        reward: float32 ``[E]``, of the last decision; 0 after a reset.
        truncated: bool ``[E]``: the clock ran out or the engine was lost.
    """

    pixels: NDArray[np.uint8]
    reward: NDArray[np.float32]
    truncated: NDArray[np.bool_]


class Fleet:
    """E games of one maze; a lost engine costs its own episode only.

    Args:
        layout: the maze.
        size: number of games E.
        rules: what each episode's scene holds.
        episode_length: decisions after which an episode is truncated.
        texture_seed: draws walls, floors and paintings.
        paintings: share of wall edges with a painting, in [0, 1].
        marks: share of wall edges with small marks of their own, in [0, 1].
        num_threads: threads that wait for engines; by default one a game, at most
            eight.

    Raises:
        ValueError: if the rules do not fit the maze or a number is out of range.
        EngineError: if the engine is not installed or cannot load the maze.
    """

    def __init__(
        self,
        layout: Layout,
        size: int,
        *,
        rules: SceneRules,
        episode_length: int,
        texture_seed: int = 0,
        paintings: float = 0.5,
        marks: float = 1.0,
        num_threads: int | None = None,
    ) -> None:
        rules.check(layout)
        if episode_length < 1:
            raise ValueError(f"episode_length must be at least 1, got {episode_length}")
        self.size = size
        self._process = os.getpid()
        self._layout = layout
        self._rules = rules
        self._episode_length = episode_length
        self._crew = Crew(
            min(size, _MOST_THREADS) if num_threads is None else num_threads
        )
        self._games: list[MazeGame] = []
        self._lost = np.zeros(size, dtype=bool)
        self._decisions = np.zeros(size, dtype=np.int64)
        # Poses after the last decision and before it.
        self._poses: list[Pose] = [Pose(0.0, 0.0, 0.0)] * size
        self._moves_from: list[Pose] = list(self._poses)
        self._pixels = np.zeros((size, HEIGHT, WIDTH, 3), dtype=np.uint8)
        self.seed(0)

        # Once, before all games ask for it at the same time.
        compile_maze(
            layout, texture_seed=texture_seed, paintings=paintings, marks=marks
        )

        # Here, because the crew's threads must not touch signals.
        instances.end_engines_on_sigterm()

        def start(_: int) -> None:
            game = MazeGame(
                layout, texture_seed=texture_seed, paintings=paintings, marks=marks
            )
            self._games.append(game)

        try:
            self._crew.run(start, range(size))
        except BaseException:
            self.close()
            raise

    def seed(self, seed: int | None) -> None:
        """Begin new streams of episodes, one a row.

        Args:
            seed: the same seed gives the same episodes in every row; ``None`` takes
                one from the operating system.
        """
        self._streams = [
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(row,)))
            for row in range(self.size)
        ]

    def reset(self, rows: Sequence[int]) -> Snapshot:
        """Begin a new episode in some rows; the others stay as they are.

        Raises:
            EngineError: if an engine cannot be started.
        """
        self._check_process()
        self._pixels = self._pixels.copy()
        self._crew.run(self._reset_row, rows)
        self._decisions[list(rows)] = 0
        return self._snapshot(np.zeros(self.size, dtype=np.float32))

    def step(
        self, actions: Sequence[int], rows: Sequence[int] | None = None
    ) -> Snapshot:
        """Take one decision in each row.

        Args:
            actions: action index of each of the E rows.
            rows: the rows that step, all by default; the others stay as they are.
        """
        self._check_process()
        if rows is None:
            rows = range(self.size)
            self._pixels = np.empty_like(self._pixels)
            self._decisions += 1
        else:
            self._pixels = self._pixels.copy()
            self._decisions[list(rows)] += 1
        reward = np.zeros(self.size, dtype=np.float32)

        def step_row(row: int) -> None:
            reward[row] = self._step_row(row, actions[row])

        self._crew.run(step_row, rows)
        return self._snapshot(reward)

    def poses(self) -> NDArray[np.float64]:
        """Where the agents stand: x, y, heading, ``[E, 3]``."""
        return np.array(self._poses)

    def moves(self) -> NDArray[np.float64]:
        """How the agents moved in the last decision, in their own frame, ``[E, 3]``.

        Forward and left in map units, then the turn in degrees, counter-clockwise;
        zero after a reset or a respawn.
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
        shut = [[slot in game.closed for slot in slots] for game in self._games]
        return np.array(shut, dtype=bool).reshape(self.size, len(slots))

    def goal_cells(self) -> NDArray[np.int64]:
        """Row and column of the goals, ``[E, 2]``, -1 without one."""
        cells = [game.scene.goal_cell or (-1, -1) for game in self._games]
        return np.array(cells, dtype=np.int64)

    def respawned(self) -> NDArray[np.bool_]:
        """Whether the goal was touched in the last decision, ``[E]``."""
        return np.array([game.respawned for game in self._games])

    def set_slot(
        self, letter: str, *, closed: bool, rows: Iterable[int] | None = None
    ) -> None:
        """Close or open a slot in some rows (all by default)."""
        for row in range(self.size) if rows is None else rows:
            # A lost engine is told of by the next step, and replaced by a reset.
            with suppress(EngineLostError):
                self._games[row].set_slot(letter, closed=closed)

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """What the current episode of each row holds."""
        return tuple(game.scene for game in self._games)

    @property
    def pids(self) -> tuple[int, ...]:
        """Process numbers of the engines."""
        return tuple(game.engine.pid for game in self._games)

    def close(self) -> None:
        """End all engines."""
        self._crew.close()
        for game in self._games:
            game.close()

    def _check_process(self) -> None:
        # A fork has no copies of the crew's threads and would wait for ever.
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
            # Drawn anew on a second try, so that the episode is the same.
            generator = np.random.default_rng(seed)
            game.reset(draw_scene(self._layout, self._rules, generator))

        try:
            if self._lost[row]:
                game.engine.restart()
            begin()
        except EngineLostError as error:
            _warn(row, error)
            game.engine.restart()
            begin()
        self._lost[row] = False
        self._poses[row] = self._moves_from[row] = game.pose
        self._pixels[row] = game.pixels

    def _step_row(self, row: int, action: int) -> float:
        """Step one game; returns the reward."""
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
