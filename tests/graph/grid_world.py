"""A world of squares whose views are their coordinates, with a map of all squares."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv

from toponav import keys
from toponav.graph import Navigator, NavigatorRules
from toponav.transforms import PreviousReward

#: North, south, west, east.
MOVES = torch.tensor([[-1, 0], [1, 0], [0, -1], [0, 1]])

#: Two paths from the left to the right end: the upper one is shorter.
RING = ("#######", "#.....#", "#.###.#", "#.###.#", "#.....#", "#######")
#: Between the corners of the upper row.
UPPER, START, GOAL = (1, 3), (1, 1), (1, 5)


class GridMap:
    """Every free square is a waypoint, and is joined with the ones beside it."""

    def __init__(self, rows: Sequence[str]) -> None:
        free = torch.tensor([[letter != "#" for letter in row] for row in rows])
        self.cells = free.nonzero()
        self.num_waypoints = len(self.cells)
        self.embeddings = self.prepared = self.cells.float()
        away = (self.cells.unsqueeze(0) - self.cells.unsqueeze(1)).abs().sum(-1)
        self.edges = ((away == 1).triu()).nonzero()
        self.edge_cost = torch.ones(len(self.edges))
        self.version = 0

    def number(self, cell: tuple[int, int]) -> int:
        return int((self.cells == torch.tensor(cell)).all(1).nonzero()[0])


def embed(views: Tensor) -> Tensor:
    return views.flatten(1)[:, :2].float()


def compare(one: Tensor, many: Tensor) -> Tensor:
    """1 for the same square, 1/2 for one beside it, 1/3 for one across a corner."""
    return 1 / (1 + (one.unsqueeze(1) - many).square().sum(-1))


def locomotion(here: Tensor, there: Tensor) -> Tensor:
    return (there - here) @ MOVES.T.float()


def make_navigator(
    grid: GridMap,
    *,
    seed: int = 0,
    goal_reward: float | None = 10.0,
    in_keys: Sequence[NestedKey] | None = None,
    **rules: object,
) -> Navigator:
    """One that reaches the squares beside it, and errs in nothing."""
    chosen = NavigatorRules(**({"tc_reach": 0.4, "temperature": 0.0} | rules))
    return Navigator(
        grid,
        embed,
        compare,
        locomotion,
        chosen,
        goal_reward=goal_reward,
        in_keys=in_keys,
        seed=seed,
    )


class GridWorld(EnvBase):
    """Squares that can be closed; the goal pays 10 and puts the agent at the start."""

    def __init__(
        self,
        rows: Sequence[str] = RING,
        *,
        start: tuple[int, int] = START,
        goal: tuple[int, int] = GOAL,
        goal_views: Sequence[tuple[int, int]] = (),
        batch_size: Sequence[int] = (),
        episode_length: int = 200,
    ) -> None:
        super().__init__(batch_size=torch.Size(batch_size))
        self.free = torch.tensor([[letter != "#" for letter in row] for row in rows])
        self.start, self.goal = torch.tensor(start), torch.tensor(goal)
        self.goal_views = torch.tensor(goal_views or [goal])
        self.episode_length = episode_length
        self.closed: set[tuple[int, int]] = set()
        shape, views = self.batch_size, len(self.goal_views)
        image = {"dtype": torch.uint8}
        self.observation_spec = Composite(
            pixels=Bounded(0, 255, (*shape, 1, 1, 3), **image),
            goal_views=Bounded(0, 255, (*shape, views, 1, 1, 3), **image),
            privileged=Composite(position=Unbounded((*shape, 2)), shape=shape),
            shape=shape,
        )
        self.action_spec = Categorical(4, shape=shape)
        self.reward_spec = Unbounded((*shape, 1))
        done = Binary(1, (*shape, 1), dtype=torch.bool)
        self.full_done_spec = Composite(
            done=done, terminated=done.clone(), truncated=done.clone(), shape=shape
        )
        self.at = self.start.expand(*shape, 2).clone()
        self.clock = torch.zeros(shape, dtype=torch.int64)

    def _set_seed(self, seed: int | None) -> None:
        pass

    def _reset(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        rows = torch.ones(self.batch_size, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(self.batch_size)
        self.at = torch.where(rows.unsqueeze(-1), self.start, self.at)
        self.clock = self.clock * ~rows
        return self._observe()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        wanted = self.at + MOVES[tensordict[keys.ACTION]]
        can = self.free[wanted[..., 0], wanted[..., 1]]
        for cell in self.closed:
            can = can & (wanted != torch.tensor(cell)).any(-1)
        self.at = torch.where(can.unsqueeze(-1), wanted, self.at)
        reached = (self.at == self.goal).all(-1, keepdim=True)
        self.at = torch.where(reached, self.start, self.at)
        self.clock = self.clock + 1
        return self._observe().set(keys.REWARD, 10.0 * reached)

    def _observe(self) -> TensorDictBase:
        shape = self.batch_size
        truncated = (self.clock >= self.episode_length).unsqueeze(-1)
        return TensorDict(
            {
                "pixels": as_view(self.at),
                "goal_views": as_view(self.goal_views).expand(*shape, -1, 1, 1, 3),
                ("privileged", "position"): self.at.float(),
                "done": truncated,
                "truncated": truncated.clone(),
                "terminated": torch.zeros_like(truncated),
            },
            batch_size=shape,
        )


def as_view(cell: Tensor) -> Tensor:
    """A picture of one pixel that names a square."""
    padded = torch.cat([cell, torch.zeros_like(cell[..., :1])], -1)
    return padded.to(torch.uint8)[..., None, None, :].clone()


def as_task(world: GridWorld) -> TransformedEnv:
    """The world with all that a navigator reads."""
    paid = PreviousReward(10.0, in_keys=[keys.REWARD])
    return TransformedEnv(world, Compose(paid, InitTracker()))
