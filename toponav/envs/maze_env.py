"""The batched TorchRL environment: E mazes on E engines in one process."""

import weakref
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from toponav.envs.batched_games import BatchedGames, Snapshot
from toponav.envs.depth import DepthCaster
from toponav.envs.engines import DEFAULT_ENGINE, load_engine
from toponav.envs.game import Look
from toponav.envs.layout import Cell, Layout
from toponav.envs.scene import SceneRules
from toponav.envs.specs import masked_rows, read_actions, set_world
from toponav.keys import PRIVILEGED
from toponav.worlds import WorldSpec


class MazeEnv(EnvBase):
    """A batch of mazes, one engine each, driven by at most eight threads.

    One step is one *decision*; ``env.world`` says what actions, view, motion and
    rewards are. Observations are ``pixels`` and, if asked for, ``depth``, ``velocity``
    and the ground truth under ``privileged``, as `toponav.keys` describes them.

    An episode starts in a random cell that is no slot, with apples and goal in others;
    it is a function of seed, row and the number of episodes that the row has begun. It
    is ``truncated`` after ``episode_length`` decisions, or when the engine was lost.
    The goal puts the agent at a new random start: ``terminated`` is always false.

    Args:
        layout: the maze.
        engine: name of the engine that runs it, a key of ``ENGINES``.
        batch_size: number of mazes E; ``None`` is one maze without a batch dimension.
        apples: number of apples in each episode.
        goal: whether each episode has a goal.
        blocked: letters of the slots that are closed from the start.
        goal_cells: cells where the goal can be; all but the slots unless given.
        episode_length: decisions in an episode.
        texture_seed: draws walls, floors and paintings.
        paintings: share of wall edges with a painting, in [0, 1], seen from far off.
        marks: share of wall edges with small marks, in [0, 1], seen from close by.
        depth: height and width of the depth picture, or ``None`` for none.
        velocity: whether to give the velocity.
        privileged: whether to give the ground truth.
        seed: seed of the episodes, random unless given; give each worker its own.
        device: where the tensors go; the engines draw on the processor.

    Raises:
        ValueError: if an argument is out of range or does not fit the maze.
        EngineError: if the engine is not installed or cannot load the maze.

    Examples:
        >>> from toponav.envs import load_maze
        >>> env = MazeEnv(load_maze("maze1"), batch_size=2, episode_length=50)
        >>> tuple(env.rollout(8)["pixels"].shape) == (2, 8, *env.world.view_size, 3)
        True
        >>> env.close()
    """

    world: WorldSpec

    def __init__(
        self,
        layout: Layout,
        *,
        engine: str = DEFAULT_ENGINE,
        batch_size: int | None = None,
        apples: int = 0,
        goal: bool = False,
        blocked: Iterable[str] = (),
        goal_cells: Iterable[Cell] | None = None,
        episode_length: int = 1800,
        texture_seed: int = 0,
        paintings: float = 0.5,
        marks: float = 1.0,
        depth: tuple[int, int] | None = None,
        velocity: bool = False,
        privileged: bool = False,
        seed: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        if batch_size is not None and batch_size < 1:
            raise ValueError(f"batch_size must be at least 1, got {batch_size}")
        shape = torch.Size([] if batch_size is None else [batch_size])
        super().__init__(device=device, batch_size=shape)
        game_engine = load_engine(engine)
        self.layout = layout
        self._caster: DepthCaster | None = None
        if depth is not None:
            camera, size = game_engine.camera, game_engine.motion.cell_size
            self._caster = DepthCaster(layout, depth, camera=camera, cell_size=size)
        cells = None if goal_cells is None else tuple(goal_cells)
        rules = SceneRules(apples, goal, tuple(blocked), cells)
        #: The games behind the tensors, with their scenes and processes.
        self.games = BatchedGames(
            game_engine,
            layout,
            batch_size or 1,
            rules=rules,
            episode_length=episode_length,
            look=Look(texture_seed=texture_seed, paintings=paintings, marks=marks),
        )
        self._end = weakref.finalize(self, self.games.close)
        self._with_velocity = velocity
        self._with_privileged = privileged
        set_world(self, game_engine.world, self._optional_specs())
        self.games.seed(seed)

    def _optional_specs(self) -> dict[str, TensorSpec]:
        shape, device = self.batch_size, self.device
        specs: dict[str, TensorSpec] = {}
        if self._caster is not None:
            size = (*shape, *self._caster.size)
            specs["depth"] = Bounded(0.0, self._caster.far, size, device=device)
        if self._with_velocity:
            specs["velocity"] = Unbounded((*shape, 6), device=device)
        if self._with_privileged:
            num_slots = len(self.layout.slots)
            last = (torch.tensor(self.layout.shape) - 1).expand(*shape, 2)
            specs[PRIVILEGED] = Composite(
                position=Unbounded((*shape, 2)),
                heading=Bounded(0.0, 360.0, (*shape, 1)),
                cell=Bounded(0, last, (*shape, 2), dtype=torch.int64),
                goal_cell=Bounded(-1, last, (*shape, 2), dtype=torch.int64),
                blocked=Binary(num_slots, (*shape, num_slots), dtype=torch.bool),
                respawned=Binary(1, (*shape, 1), dtype=torch.bool),
                shape=shape,
            ).to(device)
        return specs

    def _reset(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        rows = masked_rows(tensordict, "_reset", self.games.size)
        return self._tensordict(self.games.reset(rows)).exclude("reward")

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        rows = masked_rows(tensordict, "_step", self.games.size)
        actions = read_actions(tensordict, rows, self)
        return self._tensordict(self.games.step(actions, rows))

    def _tensordict(self, snapshot: Snapshot) -> TensorDict:
        games, done = self.games, snapshot.truncated[:, None]
        entries: dict[str, NDArray[Any]] = {
            "pixels": snapshot.pixels,
            "reward": snapshot.reward[:, None],
            "done": done,
            "truncated": done.copy(),
            "terminated": np.zeros_like(done),
        }
        if self._caster is not None:
            x, y, heading = games.poses().T
            entries["depth"] = self._caster.cast(x, y, heading, games.closed())
        if self._with_velocity:
            # The mazes are flat: up, pitch and roll are there for the paper's R^6.
            velocity = np.zeros((games.size, 6), dtype=np.float32)
            velocity[:, [0, 1, 3]] = games.moves()
            entries["velocity"] = velocity
        data = self._tensors(entries)
        if self._with_privileged:
            data.set(PRIVILEGED, self._tensors(games.truth()))
        return data

    def _tensors(self, entries: Mapping[str, NDArray[Any]]) -> TensorDict:
        """Tensors of the batch's shape on the environment's device."""
        source = {}
        for key, entry in entries.items():
            tensor = torch.from_numpy(entry if self.batch_size else entry[0])
            dtype = torch.float32 if tensor.is_floating_point() else tensor.dtype
            # Nobody writes to what was given, so that a copy to a GPU may be under way.
            source[key] = tensor.to(self.device, dtype, non_blocking=True)
        return TensorDict._new_unsafe(source, self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self.games.seed(seed)

    def set_slot(
        self, letter: str, *, closed: bool, rows: Iterable[int] | None = None
    ) -> None:
        """Close or open a slot of some rows (all by default) in mid-episode.

        At once, or when the agent is clear of it; a ``ValueError`` if it is unknown or
        would cut a maze in two, and none has then moved.
        """
        self.games.set_slot(letter, closed=closed, rows=rows)

    def close(self, *, raise_if_closed: bool = True) -> None:
        self._end()
        super().close(raise_if_closed=raise_if_closed)
