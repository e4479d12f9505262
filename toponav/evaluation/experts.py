"""Scripted policies that know the maze: upper ends of the scale, never agents.

- :class:`PathFollower` walks to the goal.
- :class:`FrontierExpert` visits every cell.
"""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from toponav.evaluation.routes import UNREACHABLE, Routes
from toponav.evaluation.steering import (
    Action,
    Motion,
    bearing,
    cell_centres,
    follow,
    wrap_degrees,
)
from toponav.keys import ACTION, BLOCKED, CELL, GOAL_CELL, HEADING, POSITION

#: Cells of a path that steering looks at; it aims 1.25 cells ahead.
_HOPS = 3


class PathFollower(TensorDictModuleBase):
    """Walks a shortest way to the goal cell, around the slots that are closed.

    It plans anew in every decision from the privileged entries, keeps nothing,
    and so follows slots that open and close and goals that move. Without a
    goal, or with no way to it, it acts at random.

    Args:
        open_mask: bool ``[rows, cols]``, true where the layout has floor.
        slot_cells: row and column of each slot, in the order of ``blocked``.
        motion: what one decision does.
        seed: of the random actions.

    Examples:
        >>> from tensordict import TensorDict
        >>> expert = PathFollower(torch.ones(1, 3, dtype=torch.bool))
        >>> pose = {POSITION: [64.0, 64.0], HEADING: [0.0], CELL: [0, 0]}
        >>> data = TensorDict({**pose, GOAL_CELL: [0, 2]})
        >>> expert(data)["action"]  # the goal is in the east, where it looks
        tensor(0)
    """

    def __init__(
        self,
        open_mask: Tensor,
        *,
        slot_cells: Sequence[tuple[int, int]] = (),
        motion: Motion | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.in_keys = [POSITION, HEADING, CELL, GOAL_CELL]
        if slot_cells:
            self.in_keys.append(BLOCKED)
        self.out_keys = [ACTION]
        self.routes = Routes(open_mask, slot_cells=slot_cells)
        self.motion = Motion() if motion is None else motion
        self.generator = torch.Generator().manual_seed(seed)
        self.centres = cell_centres(
            self.routes.cells, self.routes.shape[0], self.motion.cell_size
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        data = tensordict.select(*self.in_keys).reshape(-1).cpu()
        table = self.routes.tables(_blocked(data))
        here = self.routes.number(data[CELL])
        goal_cell = data[GOAL_CELL]
        no_goal = (goal_cell < 0).any(-1)
        goal = torch.where(no_goal, here, self.routes.number(goal_cell.clamp(min=0)))
        path = self.routes.path(table, here, goal, hops=_HOPS)
        action = follow(
            self.centres[path],
            data[POSITION],
            data[HEADING].squeeze(-1),
            motion=self.motion,
        )
        lost = no_goal | (self.routes.distances[table, here, goal] >= UNREACHABLE)
        wander = torch.randint(len(Action), action.shape, generator=self.generator)
        action = torch.where(lost, wander, action).reshape(tensordict.batch_size)
        return tensordict.set(ACTION, action.to(tensordict.device))


class FrontierExpert(TensorDictModuleBase):
    """Goes to the nearest cell that it has not visited until all are visited.

    Nearest is counted in decisions: the walk to the cell and the turns before
    the first step. Once every cell that can be reached is visited, it acts at
    random. Cells visited are kept per env and forgotten at an episode's start.

    Args:
        open_mask: bool ``[rows, cols]``, true where the layout has floor.
        slot_cells: row and column of each slot, in the order of ``blocked``.
        motion: what one decision does.
        init_key: key that is true in an episode's first decision, bool
            ``[*B, 1]`` (TorchRL's ``InitTracker`` writes it); ``None`` if
            :meth:`reset` is called by hand.
        seed: of the random actions.

    Examples:
        >>> from tensordict import TensorDict
        >>> mask = torch.ones(1, 3, dtype=torch.bool)
        >>> expert = FrontierExpert(mask, init_key=None)
        >>> pose = {POSITION: [192.0, 64.0], HEADING: [180.0], CELL: [0, 1]}
        >>> expert(TensorDict({**pose}))["action"]  # west is nearer
        tensor(0)

    Shape notation:
        B: batch of environments, flattened.  N: open cells.
    """

    visited: Tensor

    def __init__(
        self,
        open_mask: Tensor,
        *,
        slot_cells: Sequence[tuple[int, int]] = (),
        motion: Motion | None = None,
        init_key: NestedKey | None = "is_init",
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.init_key = init_key
        self.in_keys = [POSITION, HEADING, CELL]
        if slot_cells:
            self.in_keys.append(BLOCKED)
        if init_key is not None:
            self.in_keys.append(init_key)
        self.out_keys = [ACTION]
        self.routes = Routes(open_mask, slot_cells=slot_cells)
        self.motion = Motion() if motion is None else motion
        self.generator = torch.Generator().manual_seed(seed)
        self.centres = cell_centres(
            self.routes.cells, self.routes.shape[0], self.motion.cell_size
        )
        visited = torch.zeros(0, len(self.centres), dtype=torch.bool)
        self.register_buffer("visited", visited, persistent=False)

    def reset(self, rows: Tensor | None = None) -> None:
        """Forget what was visited.

        Args:
            rows: bool ``[*B]``, the envs that start anew; all of them if omitted.
        """
        if rows is None:
            self.visited = self.visited[:0]
        else:
            self.visited[rows.reshape(-1).cpu()] = False

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        data = tensordict.select(*self.in_keys).reshape(-1).cpu()
        here = self.routes.number(data[CELL])
        if len(self.visited) != len(here):
            self.visited = self.visited.new_zeros(len(here), len(self.centres))
        if self.init_key is not None:
            self.reset(data[self.init_key])
        self.visited[torch.arange(len(here)), here] = True
        table = self.routes.tables(_blocked(data))
        position, heading = data[POSITION], data[HEADING].squeeze(-1)
        cost = self._decisions_to_cells(table, here, position, heading)
        cost = cost.masked_fill(self.visited.unsqueeze(1), torch.inf).flatten(1)
        least, choice = cost.min(1)
        way = choice // len(self.centres)
        target = choice % len(self.centres)
        first = torch.where(least.isinf(), here, self.routes.neighbours[here, way])
        onward = self.routes.path(table, first, target, hops=_HOPS - 1)
        path = torch.cat([here.unsqueeze(1), onward], 1)
        action = follow(self.centres[path], position, heading, motion=self.motion)
        wander = torch.randint(len(Action), action.shape, generator=self.generator)
        action = torch.where(least.isinf(), wander, action)
        action = action.reshape(tensordict.batch_size).to(tensordict.device)
        return tensordict.set(ACTION, action)

    def _decisions_to_cells(
        self, table: Tensor, here: Tensor, position: Tensor, heading: Tensor
    ) -> Tensor:
        """Estimate the decisions to every cell by way of each neighbour.

        Returns:
            float32 ``[B, 4, N]``, infinite where there is no way.
        """
        beside = self.centres[self.routes.neighbours[here]]
        off = bearing(position.unsqueeze(1), beside) - heading.unsqueeze(1)
        start = (beside - position.unsqueeze(1)).square().sum(-1).sqrt()
        start = start / self.motion.step
        start = start + wrap_degrees(off).abs() / self.motion.turn
        steps = self.routes.first_steps(table, here)
        decisions = steps * self.motion.decisions_per_cell + start.unsqueeze(-1)
        return decisions.masked_fill(steps >= UNREACHABLE, torch.inf)


def _blocked(data: TensorDictBase) -> Tensor:
    """Return the closed slots, bool ``[B, S]``; none where the layout has none."""
    blocked: Tensor | None = data.get(BLOCKED, None)
    if blocked is None:
        return torch.zeros(len(data), 0, dtype=torch.bool)
    return blocked
