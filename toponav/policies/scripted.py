"""Scripted policies: random walks, and experts that know the maze; nothing learned."""

from collections.abc import Callable, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from toponav.ground_truth import (
    UNREACHABLE,
    Routes,
    Steering,
    bearing,
    cell_centres,
    wrap_degrees,
)
from toponav.keys import (
    ACTION,
    BLOCKED,
    CELL,
    GOAL_CELL,
    HEADING,
    POSITION,
    select_entries,
)
from toponav.worlds import WorldSpec

#: Cells of a path that steering looks at; it aims 1.25 cells ahead.
_HOPS = 3


def forward_weights(world: WorldSpec) -> tuple[float, ...]:
    """Weights of a `StickyPolicy` that favour actions that go ahead, where it is known.

    Examples:
        >>> forward_weights(WorldSpec(view_size=(64, 64), actions=("up", "down")))
        (1.0, 1.0)
    """
    if world.motion is None:
        return (1.0,) * world.num_actions
    return tuple(
        1.0 if effect.ahead <= 0 else 1.5 if effect.turn else 3.0
        for effect in world.motion.effects
    )


class RandomPolicy(TensorDictModuleBase):
    """Draws each action uniformly, as a number or one-hot.

    It sees no env, so that nothing refuses numbers in one whose actions are one-hot, as
    those of ``GymEnv`` are by default: there they all count as action 0. Copies in
    several workers need different seeds.

    Examples:
        >>> RandomPolicy(4, seed=0)(TensorDict(batch_size=[2]))["action"].shape
        torch.Size([2])
        >>> one_hot = RandomPolicy(4, seed=0, one_hot=True)
        >>> one_hot(TensorDict(batch_size=[2]))["action"].shape
        torch.Size([2, 4])
    """

    in_keys: list[NestedKey] = []
    out_keys = [ACTION]

    def __init__(
        self, num_actions: int, *, seed: int = 0, one_hot: bool = False
    ) -> None:
        if num_actions < 1:
            raise ValueError(f"num_actions must be at least 1, got {num_actions}")
        super().__init__()
        self.num_actions = num_actions
        self.one_hot = one_hot
        self.generator = torch.Generator().manual_seed(seed)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = tensordict.batch_size
        action = torch.randint(self.num_actions, shape, generator=self.generator)
        action = F.one_hot(action, self.num_actions) if self.one_hot else action
        return tensordict.set(ACTION, action.to(tensordict.device))


class StickyPolicy(TensorDictModuleBase):
    """Repeats its last action with probability ``stickiness``, else draws another.

    It gets farther than :class:`RandomPolicy`, which mostly jitters on the spot. The
    last action is carried over the end of an episode. ``weights`` are the relative
    frequencies of the actions when one is drawn; equal by default. They are written as
    numbers or one-hot, of which `RandomPolicy` says more. Copies in several
    workers need different seeds.

    Examples:
        >>> policy = StickyPolicy(4, stickiness=0.6)
        >>> first = policy(TensorDict(batch_size=[9999]))["action"]
        >>> second = policy(TensorDict(batch_size=[9999]))["action"]
        >>> round(float((first == second).float().mean()), 1)  # 0.6 + 0.4 / 4
        0.7
    """

    in_keys: list[NestedKey] = []
    out_keys = [ACTION]

    def __init__(
        self,
        num_actions: int,
        *,
        stickiness: float = 0.75,
        weights: Sequence[float] | None = None,
        seed: int = 0,
        one_hot: bool = False,
    ) -> None:
        weights = [1.0] * num_actions if weights is None else weights
        if not 0 <= stickiness <= 1:
            raise ValueError(f"stickiness must be in [0, 1], got {stickiness}")
        if len(weights) != num_actions or min(weights) < 0 or sum(weights) <= 0:
            rule = f"weights must be {num_actions} positive numbers"
            raise ValueError(f"{rule}, got {tuple(weights)}")
        super().__init__()
        self.stickiness = stickiness
        self.one_hot = one_hot
        self.generator = torch.Generator().manual_seed(seed)
        self.weights = torch.tensor(weights, dtype=torch.float32)
        # The last actions, [*B]; B is known at the first call.
        self.last = torch.empty(0, dtype=torch.int64)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = tensordict.batch_size
        drawn = torch.multinomial(
            self.weights, shape.numel(), replacement=True, generator=self.generator
        ).reshape(shape)
        if self.last.shape == shape:
            keep = torch.rand(shape, generator=self.generator) < self.stickiness
            drawn = torch.where(keep, self.last, drawn)
        self.last = drawn
        action = F.one_hot(drawn, len(self.weights)) if self.one_hot else drawn
        return tensordict.set(ACTION, action.to(tensordict.device))


class _Expert(TensorDictModuleBase):
    _more_keys: Sequence[NestedKey] = ()
    #: Of the data, the tables of routes and the cells: the next cells
    #: ``[B, _HOPS + 1]``, and whether there is a path.
    _plan: Callable[[TensorDictBase, Tensor, Tensor], tuple[Tensor, Tensor]]

    def __init__(
        self,
        open_mask: Tensor,
        *,
        world: WorldSpec,
        slot_cells: Sequence[tuple[int, int]] = (),
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.in_keys = [POSITION, HEADING, CELL, *self._more_keys]
        if slot_cells:
            self.in_keys.append(BLOCKED)
        self.out_keys = [ACTION]
        self.num_actions = world.num_actions
        self.steering = Steering(world)
        self.motion = self.steering.motion
        self.routes = Routes(open_mask, slot_cells=slot_cells)
        self.generator = torch.Generator().manual_seed(seed)
        self.centres = cell_centres(
            self.routes.cells, self.routes.shape[0], self.motion.cell_size
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        data = select_entries(tensordict, self.in_keys).reshape(-1).cpu()
        blocked = data.get(BLOCKED, torch.zeros(len(data), 0, dtype=torch.bool))
        table = self.routes.tables(blocked)
        path, has_path = self._plan(data, table, self.routes.number(data[CELL]))
        heading = data[HEADING].squeeze(-1)
        action = self.steering(self.centres[path], data[POSITION], heading)
        random = torch.randint(self.num_actions, action.shape, generator=self.generator)
        action = torch.where(has_path, action, random).reshape(tensordict.batch_size)
        return tensordict.set(ACTION, action.to(tensordict.device))


class PathFollower(_Expert):
    """Follows a shortest path to the goal cell, around the slots that are closed.

    It plans in every decision from the privileged entries and keeps nothing, so slots
    may open and close and goals may move. Without a goal, or if it is cut off, it acts
    at random. ``open_mask``, bool ``[rows, cols]``, is true where the layout has floor;
    ``world`` must suit `Steering`; ``slot_cells`` are row and column of each slot, in
    the order of ``blocked``.

    Examples:
        >>> from toponav.worlds import Effect, Motion
        >>> effects = Effect(ahead=2.5), Effect(turn=20), Effect(turn=-20)
        >>> motion = Motion(cell_size=10, effects=effects)
        >>> world = WorldSpec(view_size=(1, 1), actions=(*"alr",), motion=motion)
        >>> expert = PathFollower(torch.ones(1, 3, dtype=torch.bool), world=world)
        >>> pose = {POSITION: [5.0, 5.0], HEADING: [0.0], CELL: [0, 0]}
        >>> data = TensorDict({**pose, GOAL_CELL: [0, 2]})
        >>> expert(data)["action"]  # the goal is in the east, where it looks
        tensor(0)
    """

    _more_keys = (GOAL_CELL,)

    def _plan(
        self, data: TensorDictBase, table: Tensor, here: Tensor
    ) -> tuple[Tensor, Tensor]:
        has_goal = (data[GOAL_CELL] >= 0).all(-1)
        goal = self.routes.number(data[GOAL_CELL].clamp(min=0))
        goal = torch.where(has_goal, goal, here)
        reachable = self.routes.distances[table, here, goal] < UNREACHABLE
        return self.routes.path(table, here, goal, hops=_HOPS), has_goal & reachable


class FrontierExpert(_Expert):
    """Goes to the nearest cell that it has not visited until all are visited.

    Nearest is counted in decisions: the steps to the cell and the turns before the
    first one. Once every cell that can be reached is visited, it acts at random. In an
    episode's first decision ``init_key`` is true and it forgets what was visited; with
    ``None`` it never does. Other arguments as in `PathFollower`.

    Examples:
        >>> from toponav.worlds import Effect, Motion
        >>> effects = Effect(ahead=2.5), Effect(turn=20), Effect(turn=-20)
        >>> motion = Motion(cell_size=10, effects=effects)
        >>> world = WorldSpec(view_size=(1, 1), actions=(*"alr",), motion=motion)
        >>> corridor = torch.ones(1, 3, dtype=torch.bool)
        >>> expert = FrontierExpert(corridor, world=world, init_key=None)
        >>> middle = {POSITION: [15.0, 5.0], HEADING: [10.0], CELL: [0, 1]}
        >>> east = {POSITION: [25.0, 5.0], HEADING: [10.0], CELL: [0, 2]}
        >>> expert(TensorDict(middle))["action"]  # ahead, into the cell in the east
        tensor(0)
        >>> expert(TensorDict(east))["action"]  # to the left, back to the other end
        tensor(1)
    """

    def __init__(
        self,
        open_mask: Tensor,
        *,
        world: WorldSpec,
        slot_cells: Sequence[tuple[int, int]] = (),
        init_key: NestedKey | None = "is_init",
        seed: int = 0,
    ) -> None:
        super().__init__(open_mask, world=world, slot_cells=slot_cells, seed=seed)
        if init_key is not None:
            self.in_keys.append(init_key)
        self.init_key = init_key
        self.visited = torch.zeros(0, len(self.centres), dtype=torch.bool)

    def _plan(
        self, data: TensorDictBase, table: Tensor, here: Tensor
    ) -> tuple[Tensor, Tensor]:
        if len(self.visited) != len(here):
            self.visited = self.visited.new_zeros(len(here), len(self.centres))
        if self.init_key is not None:
            self.visited[data[self.init_key].reshape(-1)] = False
        self.visited[torch.arange(len(here)), here] = True
        cost = self._decisions_to_cells(data, table, here)
        cost = cost.masked_fill(self.visited.unsqueeze(1), torch.inf).flatten(1)
        least, choice = cost.min(1)
        has_path = ~least.isinf()
        side, target = choice // len(self.centres), choice % len(self.centres)
        first = torch.where(has_path, self.routes.neighbours[here, side], here)
        onward = self.routes.path(table, first, target, hops=_HOPS - 1)
        return torch.cat([here.unsqueeze(1), onward], 1), has_path

    def _decisions_to_cells(
        self, data: TensorDictBase, table: Tensor, here: Tensor
    ) -> Tensor:
        position = data[POSITION].unsqueeze(1)
        beside = self.centres[self.routes.neighbours[here]]
        off = wrap_degrees(bearing(position, beside) - data[HEADING])
        start = (beside - position).square().sum(-1).sqrt() / self.motion.step
        start = start + off.abs() / self.motion.turn
        steps = self.routes.first_steps(table, here)
        decisions: Tensor = steps * self.motion.decisions_per_cell + start.unsqueeze(-1)
        return decisions.masked_fill(steps >= UNREACHABLE, torch.inf)
