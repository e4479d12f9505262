"""Many mazes on many engines in one process, in lock step."""

import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from toponav.envs.game import EngineError, EngineLostError, Game, GameEngine, Look
from toponav.envs.layout import Layout
from toponav.envs.lockstep_thread_pool import LockstepThreadPool
from toponav.envs.scene import Scene, SceneRules, draw_scene
from toponav.envs.specs import episode_streams

# Threads wait for engines, not for the processor: more than cores are of use.
_MOST_THREADS = 8


class Snapshot(NamedTuple):
    """What all mazes show after a step or a reset; the arrays are the caller's."""

    pixels: NDArray[np.uint8]  # [E, H, W, 3]
    reward: NDArray[np.float32]  # [E]
    truncated: NDArray[np.bool_]  # [E]; the clock ran out or the engine was lost


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
    ) -> None:
        rules.check(layout)
        if episode_length < 1:
            raise ValueError(f"episode_length must be at least 1, got {episode_length}")
        self.engine = engine
        self.size = size
        self._process, self._is_closed = os.getpid(), False
        self._layout = layout
        cell_size = engine.motion.cell_size
        self._draw_scene = partial(draw_scene, layout, rules, cell_size=cell_size)
        self._episode_length = episode_length
        self._threads = LockstepThreadPool(min(size, _MOST_THREADS))
        self._games: list[Game] = []
        self._scenes: dict[int, Scene] = {}
        self._lost = np.zeros(size, dtype=bool)
        self._actions: list[list[int]] = [[] for _ in range(size)]
        # Poses after the last decision and before it.
        self._poses, self._moves_from = np.zeros((2, size, 3))
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
        sequence: Any = np.random.SeedSequence(seed)
        self._seed: int = sequence.entropy
        self._begun = [0] * self.size  # episodes of each row
        self._streams = episode_streams(self._seed, self.size)

    def reset(self, rows: Sequence[int]) -> Snapshot:
        """Begin a new episode in some rows; the others stay as they are."""
        self._check_playable()
        self._pixels = self._pixels.copy()
        self._threads.run(self._reset_row, rows)
        return self._snapshot(np.zeros(self.size, dtype=np.float32))

    def step(
        self, actions: Sequence[int], rows: Sequence[int] | None = None
    ) -> Snapshot:
        """Take one decision in some rows (all by default), of the E actions given.

        A ``ValueError`` if there is no such action; no row has then stepped.
        """
        self._check_playable()
        rows = range(self.size) if rows is None else rows
        num_actions = self.engine.world.num_actions
        for row in rows:
            if not 0 <= actions[row] < num_actions:
                raise ValueError(
                    f"action must be in [0, {num_actions}), got {actions[row]}"
                )
        self._pixels = self._pixels.copy()
        reward = np.zeros(self.size, dtype=np.float32)

        def step_row(row: int) -> None:
            reward[row] = self._step_row(row, actions[row])

        self._threads.run(step_row, rows)
        return self._snapshot(reward)

    def running_episodes(self) -> dict[str, Any]:
        """What `resume_episodes` needs, as plain values; moved slots are not in it."""
        return {"seed": self._seed, "begun": self._begun, "actions": self._actions}

    def resume_episodes(self, state: Mapping[str, Any]) -> None:
        """Play episodes again up to where `running_episodes` was called."""
        self._check_playable()
        self.seed(state["seed"])

        def play(row: int) -> None:
            self._begun[row] = state["begun"][row] - 1
            self._streams[row].integers(2**63, size=self._begun[row])
            self._reset_row(row)
            for action in state["actions"][row]:
                self._step_row(row, action)

        self._threads.run(play, range(self.size))

    def poses(self) -> NDArray[np.float64]:
        """Where the agents stand: x, y, heading, ``[E, 3]``."""
        return self._poses.copy()

    def moves(self) -> NDArray[np.float64]:
        """How the agents moved in the last decision, in their own frame, ``[E, 3]``.

        Forward and left in map units, then the turn in degrees, counter-clockwise; zero
        after a reset or a respawn.
        """
        dx, dy, turned = (self._poses - self._moves_from).T
        angle = np.deg2rad(self._moves_from[:, 2])
        forward = dx * np.cos(angle) + dy * np.sin(angle)
        left = dy * np.cos(angle) - dx * np.sin(angle)
        return np.stack([forward, left, (turned + 180.0) % 360.0 - 180.0], axis=1)

    def closed(self) -> NDArray[np.bool_]:
        """Which slots are closed, ``[E, S]``, in the layout's order."""
        slots = list(self._layout.slots)
        closed = [[slot in game.closed for slot in slots] for game in self._games]
        return np.array(closed, dtype=bool).reshape(self.size, len(slots))

    def truth(self) -> dict[str, NDArray[np.generic]]:
        """The entries under ``privileged`` in `toponav.keys`, ``[E, ...]``."""
        size = self.engine.motion.cell_size
        cells = [self._layout.cell_of(x, y, size) for x, y, _ in self._poses]
        goals = [scene.goal_cell or (-1, -1) for scene in self.scenes]
        # A game that has lost its engine still shows the decision before.
        respawned = np.array([[game.respawned] for game in self._games])
        return {
            "position": self._poses[:, :2].copy(),
            "heading": self._poses[:, 2:].copy(),
            "cell": np.array(cells, dtype=np.int64),
            "goal_cell": np.array(goals, dtype=np.int64),
            "blocked": self.closed(),
            "respawned": respawned & ~self._lost[:, None],
        }

    def set_slot(
        self, letter: str, *, closed: bool, rows: Iterable[int] | None = None
    ) -> None:
        """Close or open a slot in some rows (all by default).

        A ``ValueError`` if it is unknown or cuts one of the mazes in two; nothing has
        then moved in any of them.
        """
        rows = range(self.size) if rows is None else list(rows)
        for row in rows:
            self._games[row].check_slot(letter, closed=closed)
        for row in rows:
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
        """End all engines; they play no more."""
        self._is_closed = True
        self._threads.close()
        for game in self._games:
            game.close()

    def _check_playable(self) -> None:
        if self._is_closed:
            raise EngineError("the mazes must be open, and they were closed")
        # A fork has no copies of the pool's threads and would never return.
        if os.getpid() != self._process:
            raise EngineError(
                "a forked process must make mazes of its own, got its parent's"
            )

    def _snapshot(self, reward: NDArray[np.float32]) -> Snapshot:
        played = np.array([len(row) for row in self._actions])
        truncated = self._lost | (played >= self._episode_length)
        return Snapshot(self._pixels, reward, truncated)

    def _reset_row(self, row: int) -> None:
        game = self._games[row]
        self._begun[row] += 1
        self._actions[row] = []
        seed = int(self._streams[row].integers(2**63))
        for is_second_try in (False, True):
            try:
                if self._lost[row]:
                    game.restart()
                # Drawn again on a second try, so that the episode is the same.
                self._scenes[row] = self._draw_scene(np.random.default_rng(seed))
                game.reset(self._scenes[row])
                break
            except EngineLostError as error:
                if is_second_try:
                    raise
                _warn(row, error)
                self._lost[row] = True
        self._lost[row] = False
        self._poses[row] = self._moves_from[row] = game.pose
        self._pixels[row] = game.pixels

    def _step_row(self, row: int, action: int) -> float:
        game, reward = self._games[row], 0.0
        self._actions[row].append(action)
        if not self._lost[row]:
            try:
                game.step(action)
                reward = game.reward
            except EngineLostError as error:
                self._lost[row] = True
                _warn(row, error)
        moved = not (self._lost[row] or game.respawned)
        self._moves_from[row] = self._poses[row] if moved else game.pose
        self._poses[row] = game.pose
        self._pixels[row] = game.pixels
        return reward


def _warn(row: int, error: EngineLostError) -> None:
    warnings.warn(
        f"maze {row} of the batch lost its engine and gets a new one; its episode is "
        f"truncated ({error})",
        RuntimeWarning,
        stacklevel=2,
    )
