"""`Coverage`: how much of the maze each env has visited in this episode."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded

from toponav.keys import BLOCKED, CELL, COVERAGE, COVERAGE_REWARD, DECISIONS_TO_COVERAGE
from toponav.transforms.specs import (
    KeyedTransform,
    Keys,
    ResizableBuffers,
    find_spec,
    restarting_rows,
)


class Coverage(ResizableBuffers, KeyedTransform):
    """Measures which share of the open cells an env has visited this episode.

    The reward is the number of cells entered for the first time in this decision. It
    reads privileged keys: no agent sees it. A closed slot counts neither as open nor as
    visited; when it opens, coverage may fall.

    Args:
        open_mask: bool ``[rows, cols]``, true where there is floor, slots included.
        levels: L shares in (0, 1] of which the first decision is written.
        slot_cells: row and column of each of S slots, whose key is `BLOCKED`; empty to
            ignore closed slots.
        in_keys: key of the cell, int64 ``[*B, 2]`` (row, column).
        out_keys: keys of coverage and reward, float32 ``[*B, 1]``, and of the
            decisions to each level, int64 ``[*B, L]``, -1 if not reached yet.

    Examples:
        >>> from tensordict import TensorDict
        >>> meter = Coverage(torch.ones(1, 4, dtype=torch.bool), levels=(0.5, 1.0))
        >>> start = meter._reset(TensorDict(), TensorDict({CELL: torch.tensor([0, 0])}))
        >>> now = meter._step(TensorDict(), TensorDict({CELL: torch.tensor([0, 1])}))
        >>> now[COVERAGE], now[COVERAGE_REWARD], now[DECISIONS_TO_COVERAGE]
        (tensor([0.5000]), tensor([1.]), tensor([ 1, -1]))
    """

    default_keys = [CELL], [COVERAGE, COVERAGE_REWARD, DECISIONS_TO_COVERAGE]
    open_cells: Tensor
    slot_indices: Tensor
    levels: Tensor
    visited: Tensor
    decisions: Tensor
    decisions_to: Tensor

    def __init__(
        self,
        open_mask: Tensor,
        levels: Sequence[float] = (0.5, 0.9, 1.0),
        *,
        slot_cells: Sequence[tuple[int, int]] = (),
        in_keys: Keys = None,
        out_keys: Keys = None,
    ) -> None:
        _check_arguments(open_mask, levels, slot_cells)
        super().__init__(in_keys, out_keys)
        self.num_columns = open_mask.shape[1]
        slots = [row * self.num_columns + column for row, column in slot_cells]
        for name, values in {
            "open_cells": open_mask.flatten().clone(),
            "slot_indices": torch.tensor(slots, dtype=torch.int64),
            "levels": torch.tensor(tuple(levels), dtype=torch.float64),
        }.items():
            self.register_buffer(name, values, persistent=False)
        # One row per env, [*B, cells], [*B] and [*B, L]; B comes with a reset.
        self.register_buffer("visited", torch.empty(0, dtype=torch.bool))
        self.register_buffer("decisions", torch.empty(0, dtype=torch.int64))
        self.register_buffer("decisions_to", torch.empty(0, dtype=torch.int64))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        cell = tensordict_reset[self.in_keys[0]]
        shape = cell.shape[:-1]
        self.to(cell.device)
        if self.decisions.shape != shape:
            self.visited = self.visited.new_zeros(*shape, len(self.open_cells))
            self.decisions = self.decisions.new_zeros(shape)
            self.decisions_to = self.decisions.new_full((*shape, len(self.levels)), -1)
        rows = restarting_rows(self, tensordict, shape, cell.device)
        self.visited.masked_fill_(rows.unsqueeze(-1), False)
        self.decisions.masked_fill_(rows, 0)
        self.decisions_to.masked_fill_(rows.unsqueeze(-1), -1)
        self._measure(tensordict_reset, rows)
        return tensordict_reset

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        self.decisions += 1
        every_row = torch.ones_like(self.decisions, dtype=torch.bool)
        is_new = self._measure(next_tensordict, every_row)
        return next_tensordict.set(self.out_keys[1], is_new.to(torch.float32))

    def _measure(self, tensordict: TensorDictBase, rows: Tensor) -> Tensor:
        """Write what the rows have covered; whether a row entered a new cell."""
        cell = tensordict[self.in_keys[0]]
        index = (cell[..., :1] * self.num_columns + cell[..., 1:]) * rows.unsqueeze(-1)
        open_now = self.open_cells.expand(*rows.shape, -1)
        if len(self.slot_indices):
            open_now = open_now.index_copy(-1, self.slot_indices, ~tensordict[BLOCKED])
        seen = self.visited.gather(-1, index)
        self.visited.scatter_(-1, index, seen | rows.unsqueeze(-1))
        num_visited = (self.visited & open_now).sum(-1, keepdim=True)
        num_open = open_now.sum(-1, keepdim=True)
        # 0.9 of 10 cells is 9 cells, although 0.9 * 10 may round to more.
        needed = (self.levels * num_open - 1e-6).ceil()
        first = (self.decisions_to < 0) & (num_visited >= needed) & rows.unsqueeze(-1)
        self.decisions_to = torch.where(
            first, self.decisions.unsqueeze(-1), self.decisions_to
        )
        tensordict.set(self.out_keys[0], num_visited / num_open)
        tensordict.set(self.out_keys[2], self.decisions_to.clone())
        return ~seen & open_now.gather(-1, index)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        cell = find_spec(observation_spec, self.in_keys[0], length=2)
        if num_slots := len(self.slot_indices):
            find_spec(observation_spec, BLOCKED, length=num_slots)
        shape, device = cell.shape[:-1], observation_spec.device
        share = Bounded(0.0, 1.0, (*shape, 1), device, torch.float32)
        reached = Unbounded((*shape, len(self.levels)), device, torch.int64)
        observation_spec[self.out_keys[0]] = share
        observation_spec[self.out_keys[2]] = reached
        return observation_spec

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        cell = self.parent.observation_spec[self.in_keys[0]]
        spec = Unbounded((*cell.shape[:-1], 1), cell.device, torch.float32)
        return reward_spec.set(self.out_keys[1], spec)


def _check_arguments(
    open_mask: Tensor, levels: Sequence[float], slot_cells: Sequence[tuple[int, int]]
) -> None:
    if open_mask.ndim != 2 or open_mask.dtype is not torch.bool:
        raise ValueError(
            "open_mask must be bool [rows, cols], "
            f"got {open_mask.dtype} {tuple(open_mask.shape)}"
        )
    if not open_mask.any():
        raise ValueError("open_mask must have an open cell, got none")
    if not levels or not all(0 < level <= 1 for level in levels):
        raise ValueError(f"levels must be in (0, 1], got {tuple(levels)}")
    open_cells = open_mask.nonzero().tolist()
    for cell in slot_cells:
        if list(cell) not in open_cells:
            raise ValueError(f"slot_cells must be open cells, got {cell}")
