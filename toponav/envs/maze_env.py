"""The batched TorchRL environment: E mazes on E engines in one process."""

import weakref
from collections.abc import Iterable

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from toponav.envs.depth import DepthCaster
from toponav.envs.doom.engine import HEIGHT, WIDTH
from toponav.envs.doom.fleet import Fleet, Snapshot
from toponav.envs.doom.game import NUM_ACTIONS
from toponav.envs.layout import Layout
from toponav.envs.scene import Scene, SceneRules
from toponav.keys import PRIVILEGED

# An entry of a tensordict before it becomes one.
Entry = NDArray[np.generic] | dict[str, "Entry"]


class DoomMazeEnv(EnvBase):
    """A batch of mazes, one engine each, driven by a thread pool in one process.

    Description:
        First-person mazes with discrete, non-slipping motion. One step is one
        *decision*: the action's buttons are held for four engine tics.

    Action Space:
        ``action`` int64 ``[*B]``: 0 forward, 1 backward, 2 turn left, 3 turn
        right, 4 forward and left, 5 forward and right. A cell is 128 map units,
        3.9 decisions; a turn is 20 degrees.

    Observation Space:
        ``pixels`` uint8 ``[*B, 120, 160, 3]``. If asked for: ``depth`` float32
        ``[*B, H, W]`` (planar, map units), ``velocity`` float32 ``[*B, 6]``, and
        under ``privileged`` the truth that evaluation needs (see
        ``toponav.keys``).

    Starting State:
        A random cell that is no slot, up to 0.2 cells off its centre, a random
        heading; apples and goal in other cells. Each episode is a function of
        seed, row and the number of episodes that the row has begun.

    Rewards:
        1 for an apple, 10 for the goal, else 0.

    Episode End:
        ``truncated`` after ``episode_length`` decisions, or when the engine was
        lost (it is replaced at the next reset, with a warning). A goal never ends
        an episode, it puts the agent at a new random start: ``terminated`` is
        always false.

    Args:
        layout: the maze.
        batch_size: number of mazes E; ``None`` is one maze without a batch
            dimension.
        apples: number of apples in each episode.
        goal: whether each episode has a goal.
        blocked: letters of the slots that are closed from the start.
        episode_length: decisions in an episode.
        texture_seed: draws walls, floors and paintings.
        paintings: share of wall edges with a painting, in [0, 1].
        marks: share of wall edges with small marks of their own, in [0, 1].
        depth: height and width of the depth picture, or ``None`` for none.
        velocity: whether to give the velocity.
        privileged: whether to give the truth.
        seed: seed of the episodes, drawn from the operating system unless given;
            ``set_seed`` changes it. Two environments with the same seed play the
            same episodes, so give each worker its own.
        num_threads: threads of the pool, by default one a maze, at most eight.
        device: where the tensors go; the engines draw on the processor.

    Raises:
        ValueError: if an argument is out of range or does not fit the maze.
        EngineError: if the engine is not installed or cannot load the maze.

    Examples:
        >>> from toponav.envs import load_maze
        >>> env = DoomMazeEnv(load_maze("maze1"), batch_size=2, episode_length=50)
        >>> rollout = env.rollout(8)
        >>> rollout["pixels"].shape
        torch.Size([2, 8, 120, 160, 3])
        >>> env.close()

    Shape notation:
        B: batch, ``[E]`` or nothing.  S: slots.  H, W: height and width.
    """

    def __init__(
        self,
        layout: Layout,
        *,
        batch_size: int | None = None,
        apples: int = 0,
        goal: bool = False,
        blocked: Iterable[str] = (),
        episode_length: int = 1800,
        texture_seed: int = 0,
        paintings: float = 0.5,
        marks: float = 1.0,
        depth: tuple[int, int] | None = None,
        velocity: bool = False,
        privileged: bool = False,
        seed: int | None = None,
        num_threads: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        if batch_size is not None and batch_size < 1:
            raise ValueError(f"batch_size must be at least 1, got {batch_size}")
        shape = torch.Size([] if batch_size is None else [batch_size])
        super().__init__(device=device, batch_size=shape)
        self.layout = layout
        self._caster = None if depth is None else DepthCaster(layout, depth)
        self._fleet = Fleet(
            layout,
            batch_size or 1,
            rules=SceneRules(apples=apples, goal=goal, blocked=tuple(blocked)),
            episode_length=episode_length,
            texture_seed=texture_seed,
            paintings=paintings,
            marks=marks,
            num_threads=num_threads,
        )
        self._end = weakref.finalize(self, self._fleet.close)
        self._with_velocity = velocity
        self._with_privileged = privileged
        self._make_specs()
        self._fleet.seed(seed)

    def _make_specs(self) -> None:
        shape, device = self.batch_size, self.device
        observation = Composite(
            pixels=Bounded(
                0, 255, (*shape, HEIGHT, WIDTH, 3), dtype=torch.uint8, device=device
            ),
            shape=shape,
            device=device,
        )
        if self._caster is not None:
            observation["depth"] = Bounded(
                0.0, self._caster.far, (*shape, *self._caster.size), device=device
            )
        if self._with_velocity:
            observation["velocity"] = Unbounded((*shape, 6), device=device)
        if self._with_privileged:
            observation[PRIVILEGED] = self._privileged_spec()
        self.observation_spec = observation
        self.action_spec = Categorical(NUM_ACTIONS, shape=shape, device=device)
        self.reward_spec = Unbounded((*shape, 1), device=device)
        self.done_spec = Composite(
            {
                key: Binary(1, (*shape, 1), dtype=torch.bool, device=device)
                for key in ("done", "terminated", "truncated")
            },
            shape=shape,
            device=device,
        )

    def _privileged_spec(self) -> Composite:
        shape, device = self.batch_size, self.device
        rows, columns = self.layout.shape
        num_slots = len(self.layout.slots)
        integer = {"dtype": torch.int64, "device": device}
        flag = {"dtype": torch.bool, "device": device}
        last = torch.tensor([rows, columns]) - 1
        return Composite(
            position=Unbounded((*shape, 2), device=device),
            heading=Bounded(0.0, 360.0, (*shape, 1), device=device),
            cell=Bounded(0, last.expand(*shape, 2), (*shape, 2), **integer),
            goal_cell=Bounded(-1, last.expand(*shape, 2), (*shape, 2), **integer),
            blocked=Binary(num_slots, (*shape, num_slots), **flag),
            respawned=Binary(1, (*shape, 1), **flag),
            shape=shape,
            device=device,
        )

    def _reset(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        rows = list(range(self._fleet.size))
        if mask is not None:
            rows = np.flatnonzero(mask.cpu().numpy()).tolist()
        snapshot = self._fleet.reset(rows)
        return self._tensordict(self._observation(snapshot), snapshot.truncated)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        actions = tensordict.get("action").reshape(-1).tolist()
        partial = tensordict.get("_step", None)
        rows = None
        if partial is not None:
            rows = np.flatnonzero(partial.cpu().numpy()).tolist()
        snapshot = self._fleet.step(actions, rows)
        entries = self._observation(snapshot)
        entries["reward"] = snapshot.reward[:, None]
        return self._tensordict(entries, snapshot.truncated)

    def _observation(self, snapshot: Snapshot) -> dict[str, Entry]:
        entries: dict[str, Entry] = {"pixels": snapshot.pixels}
        if self._caster is not None:
            x, y, heading = self._fleet.poses().T
            entries["depth"] = self._caster.cast(x, y, heading, self._fleet.closed())
        if self._with_velocity:
            entries["velocity"] = self._velocity()
        if self._with_privileged:
            entries[PRIVILEGED] = self._privileged()
        return entries

    def _velocity(self) -> NDArray[np.float32]:
        # The mazes are flat: up, pitch and roll are there for the paper's R^6.
        velocity = np.zeros((self._fleet.size, 6), dtype=np.float32)
        velocity[:, [0, 1, 3]] = self._fleet.moves()
        return velocity

    def _privileged(self) -> dict[str, Entry]:
        poses = self._fleet.poses()
        return {
            "position": poses[:, :2].astype(np.float32),
            "heading": poses[:, 2:].astype(np.float32),
            "cell": self.layout.cells_of(poses[:, 0], poses[:, 1]),
            "goal_cell": self._fleet.goal_cells(),
            "blocked": self._fleet.closed(),
            "respawned": self._fleet.respawned()[:, None],
        }

    def _tensordict(
        self, entries: dict[str, Entry], truncated: NDArray[np.bool_]
    ) -> TensorDict:
        """Tensors of the batch's shape on the environment's device."""
        done = truncated[:, None]
        entries["done"], entries["truncated"] = done, done.copy()
        entries["terminated"] = np.zeros_like(done)
        return self._nested(entries)

    def _nested(self, entries: dict[str, Entry]) -> TensorDict:
        source = {}
        for key, entry in entries.items():
            if isinstance(entry, dict):
                source[key] = self._nested(entry)
                continue
            tensor = torch.from_numpy(entry)
            if not self.batch_size:
                tensor = tensor[0]
            source[key] = tensor.to(self.device)
        return TensorDict._new_unsafe(
            source, batch_size=self.batch_size, device=self.device
        )

    def _set_seed(self, seed: int | None) -> None:
        self._fleet.seed(seed)

    def set_slot(
        self, letter: str, *, closed: bool, rows: Iterable[int] | None = None
    ) -> None:
        """Close or open a slot in mid-episode; takes effect with the next decision.

        A closing waits while the agent stands in the slot or at its edge.

        Args:
            letter: the slot.
            closed: whether to close or to open it.
            rows: which of the batch's mazes; all by default.

        Raises:
            ValueError: if the slot is unknown, or would cut a maze in two.
        """
        self._fleet.set_slot(letter, closed=closed, rows=rows)

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """What the current episode of each row holds: the truth, for pictures."""
        return self._fleet.scenes

    @property
    def engine_pids(self) -> tuple[int, ...]:
        """Process numbers of the engines, one a row."""
        return self._fleet.pids

    def close(self, *, raise_if_closed: bool = True) -> None:
        self._end()
        super().close(raise_if_closed=raise_if_closed)
