"""Coverage: how much of the maze each env has visited in this episode."""

from collections.abc import Mapping, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs.transforms import Transform

from toponav.keys import (
    BLOCKED,
    CELL,
    COVERAGE,
    COVERAGE_REWARD,
    DECISIONS_TO_COVERAGE,
)
from toponav.transforms.episode_buffers import match_buffers, reset_rows

_OUT_KEYS = [COVERAGE, COVERAGE_REWARD, DECISIONS_TO_COVERAGE]


class Coverage(Transform):
    """Measures which share of the open cells an env has visited this episode.

    ``coverage = visited open cells / open cells``; the start cell counts. The
    reward is the number of cells entered for the first time in this decision,
    and for each level the decision at which coverage first reached it is kept.
    It reads privileged keys only and is for evaluation: no agent sees it.

    A slot that is closed at the moment counts neither as open nor as visited;
    when it opens in mid-episode, coverage may fall, and levels once reached
    stay reached.

    Args:
        open_mask: bool ``[rows, cols]``, true where the layout has floor; slots
            are floor.
        levels: shares in (0, 1] whose decisions are recorded.
        slot_cells: row and column of each slot, in the order of ``blocked_key``;
            empty to ignore closed slots.
        in_keys: key of the cell, int64 ``[*B, 2]`` (row, column).
        out_keys: keys of the coverage, float32 ``[*B, 1]``, the reward, float32
            ``[*B, 1]``, and the decisions to each level, int64 ``[*B, L]``, -1
            if not reached yet.
        blocked_key: key of the closed slots, bool ``[*B, S]``.

    Raises:
        ValueError: if an argument is out of range, and when the env's specs are
            read, if a key is missing or has another shape.

    Examples:
        A corridor of four cells, walked from left to right:

        >>> from tensordict import TensorDict
        >>> meter = Coverage(torch.ones(1, 4, dtype=torch.bool), levels=(0.5, 1.0))
        >>> def at(column):
        ...     return TensorDict({CELL: torch.tensor([0, column])})
        >>> start = meter._reset(TensorDict(), at(0))
        >>> for column in (0, 1, 2):
        ...     now = meter._step(TensorDict(), at(column))
        >>> now[COVERAGE], now[COVERAGE_REWARD], now[DECISIONS_TO_COVERAGE]
        (tensor([0.7500]), tensor([1.]), tensor([ 2, -1]))

    Shape notation:
        B: batch of environments.  S: slots.  L: levels.
    """

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
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
        blocked_key: NestedKey = BLOCKED,
    ) -> None:
        open_mask = torch.as_tensor(open_mask)
        _check_arguments(open_mask, levels, slot_cells)
        super().__init__(
            in_keys=[CELL] if in_keys is None else in_keys,
            out_keys=_OUT_KEYS if out_keys is None else out_keys,
        )
        if len(self.in_keys) != 1 or len(self.out_keys) != len(_OUT_KEYS):
            raise ValueError(
                "in_keys must be one key and out_keys three, "
                f"got {self.in_keys} and {self.out_keys}"
            )
        self.blocked_key = blocked_key
        self.num_columns = open_mask.shape[1]
        slots = [row * self.num_columns + column for row, column in slot_cells]

        def constant(name: str, values: Tensor) -> None:
            self.register_buffer(name, values, persistent=False)

        constant("open_cells", open_mask.flatten().clone())
        constant("slot_indices", torch.tensor(slots, dtype=torch.int64))
        constant("levels", torch.tensor(tuple(levels), dtype=torch.float64))
        # One row per env, [*B, cells], [*B] and [*B, L]; B comes with a reset.
        self.register_buffer("visited", torch.empty(0, dtype=torch.bool))
        self.register_buffer("decisions", torch.empty(0, dtype=torch.int64))
        self.register_buffer("decisions_to", torch.empty(0, dtype=torch.int64))

    def _load_from_state_dict(
        self, state_dict: Mapping[str, object], prefix: str, *args: object
    ) -> None:
        match_buffers(self, state_dict, prefix)
        super()._load_from_state_dict(state_dict, prefix, *args)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        cell = tensordict_reset.get(self.in_keys[0])
        shape = cell.shape[:-1]
        self._follow(shape, cell.device)
        reset_keys = ["_reset"] if self.parent is None else self.parent.reset_keys
        rows = reset_rows(tensordict, reset_keys, shape).to(cell.device)
        self.visited.masked_fill_(rows.unsqueeze(-1), False)
        self.decisions.masked_fill_(rows, 0)
        self.decisions_to.masked_fill_(rows.unsqueeze(-1), -1)
        self._measure(tensordict_reset, rows)
        return tensordict_reset

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        cell = next_tensordict.get(self.in_keys[0])
        self._follow(cell.shape[:-1], cell.device)
        self.decisions += 1
        new = self._measure(
            next_tensordict, torch.ones_like(self.decisions, dtype=torch.bool)
        )
        next_tensordict.set(self.out_keys[1], new.to(torch.float32))
        return next_tensordict

    def _follow(self, shape: torch.Size, device: torch.device) -> None:
        """Give the buffers one row per env and move them to the data's device."""
        if self.visited.device != device or self.open_cells.device != device:
            self.to(device)
        if self.decisions.shape != shape:
            num_cells, num_levels = len(self.open_cells), len(self.levels)
            self.visited = self.visited.new_zeros(*shape, num_cells)
            self.decisions = self.decisions.new_zeros(shape)
            self.decisions_to = self.decisions_to.new_full((*shape, num_levels), -1)

    def _open_now(self, tensordict: TensorDictBase, shape: torch.Size) -> Tensor:
        """Return bool ``[*B, cells]``: the floor without the closed slots."""
        open_now = self.open_cells.expand(*shape, -1)
        if not len(self.slot_indices):
            return open_now
        free = ~tensordict.get(self.blocked_key)
        return open_now.index_copy(-1, self.slot_indices, free)

    def _measure(self, tensordict: TensorDictBase, rows: Tensor) -> Tensor:
        """Mark where the envs of ``rows`` stand; write coverage and decisions.

        Returns:
            bool ``[*B, 1]``: whether that cell is open and was not visited yet.
        """
        cell = tensordict.get(self.in_keys[0])
        index = (cell[..., :1] * self.num_columns + cell[..., 1:]) * rows.unsqueeze(-1)
        open_now = self._open_now(tensordict, rows.shape)
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
        cell_key = self.in_keys[0]
        wanted = {cell_key: 2}
        if len(self.slot_indices):
            wanted[self.blocked_key] = len(self.slot_indices)
        for key, length in wanted.items():
            if key not in observation_spec.keys(True, True):
                raise ValueError(f"{key!r} must be an observation of the env, got none")
            if observation_spec[key].shape[-1:] != (length,):
                raise ValueError(
                    f"{key!r} must be [*B, {length}], got {observation_spec[key].shape}"
                )
        shape, device = observation_spec[cell_key].shape[:-1], observation_spec.device
        observation_spec[self.out_keys[0]] = Bounded(
            0.0, 1.0, shape=(*shape, 1), dtype=torch.float32, device=device
        )
        observation_spec[self.out_keys[2]] = Unbounded(
            shape=(*shape, len(self.levels)), dtype=torch.int64, device=device
        )
        return observation_spec

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        cell = self.parent.observation_spec[self.in_keys[0]]
        reward_spec[self.out_keys[1]] = Unbounded(
            shape=(*cell.shape[:-1], 1), dtype=torch.float32, device=cell.device
        )
        return reward_spec


def _check_arguments(
    open_mask: Tensor,
    levels: Sequence[float],
    slot_cells: Sequence[tuple[int, int]],
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
    rows, columns = open_mask.shape
    for row, column in slot_cells:
        inside = 0 <= row < rows and 0 <= column < columns
        if not inside or not open_mask[row, column]:
            raise ValueError(f"slot_cells must be open cells, got {(row, column)}")
