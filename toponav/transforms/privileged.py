"""What evaluation reads of an episode's ground truth: coverage, spurious waypoints."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, TensorSpec, Unbounded

from toponav import keys
from toponav.keys import read_entry
from toponav.transforms.specs import (
    EpisodeMemory,
    GrowingSlots,
    KeyedTransform,
    Keys,
    find_spec,
    move_to,
    require_reset,
    restarting_rows,
)


class Coverage(EpisodeMemory, KeyedTransform):
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

    Raises:
        ValueError: if an argument is not as above, or the env's spec of the cell allows
            some that lie outside ``open_mask``.

    Examples:
        >>> meter = Coverage(torch.ones(1, 4, dtype=torch.bool), levels=(0.5, 1.0))
        >>> west, east = (TensorDict({keys.CELL: torch.tensor([0, x])}) for x in (0, 1))
        >>> start = meter._reset(TensorDict(), west)
        >>> now = meter._step(TensorDict(), east)
        >>> now[keys.COVERAGE], now[keys.DECISIONS_TO_COVERAGE]
        (tensor([0.5000]), tensor([ 1, -1]))
    """

    default_keys = (
        [keys.CELL],
        [keys.COVERAGE, keys.COVERAGE_REWARD, keys.DECISIONS_TO_COVERAGE],
    )
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
        if open_mask.ndim != 2 or open_mask.dtype is not torch.bool:
            got = f"{open_mask.dtype} {tuple(open_mask.shape)}"
            raise ValueError(f"open_mask must be bool [rows, cols], got {got}")
        if not open_mask.any():
            raise ValueError("open_mask must have an open cell, got none")
        if not levels or not all(0 < level <= 1 for level in levels):
            raise ValueError(f"levels must be in (0, 1], got {tuple(levels)}")
        open_cells = open_mask.nonzero().tolist()
        if walls := [cell for cell in slot_cells if list(cell) not in open_cells]:
            raise ValueError(f"slot_cells must be open cells, got {walls[0]}")
        super().__init__(in_keys, out_keys)
        self.num_rows, self.num_columns = open_mask.shape
        slots = [row * self.num_columns + column for row, column in slot_cells]
        for name, values in {
            "open_cells": open_mask.flatten().clone(),
            "slot_indices": torch.tensor(slots, dtype=torch.int64),
            "levels": torch.tensor(tuple(levels), dtype=torch.float64),
        }.items():
            self.register_buffer(name, values, persistent=False)
        # One row per env, [*B, cells], [*B] and [*B, L]; B comes with a reset.
        self.register_buffer("visited", torch.empty(0, dtype=torch.bool))
        for name in ("decisions", "decisions_to"):
            self.register_buffer(name, torch.empty(0, dtype=torch.int64))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        cell = read_entry(tensordict_reset, self.in_keys[0])
        shape = cell.shape[:-1]
        move_to(self, cell.device)
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
        cell = read_entry(next_tensordict, self.in_keys[0])
        require_reset(self.decisions.shape, cell.shape[:-1])
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
            slots_open = ~read_entry(tensordict, keys.BLOCKED)
            open_now = open_now.index_copy(-1, self.slot_indices, slots_open)
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

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        self.require_last_views()
        # Asking `parent` for specs would compute those of all earlier transforms again.
        output_spec = output_spec.clone()
        observations = output_spec["full_observation_spec"]
        cell = find_spec(observations, self.in_keys[0], length=2)
        if num_slots := len(self.slot_indices):
            find_spec(observations, keys.BLOCKED, length=num_slots)
        self._require_cells_inside(cell)
        shape, device = cell.shape[:-1], cell.device
        share = Bounded(0.0, 1.0, (*shape, 1), device, torch.float32)
        reached = Unbounded((*shape, len(self.levels)), device, torch.int64)
        observations[self.out_keys[0]] = share
        observations[self.out_keys[2]] = reached
        new = Unbounded((*shape, 1), device, torch.float32)
        output_spec["full_reward_spec"][self.out_keys[1]] = new
        return output_spec

    def _require_cells_inside(self, spec: TensorSpec) -> None:
        """A cell beyond the mask's last column would count as one of the next row."""
        if not isinstance(spec, Bounded):
            return
        row, column = spec.space.high.reshape(-1, 2).amax(0).tolist()
        if row >= self.num_rows or column >= self.num_columns:
            raise ValueError(
                "open_mask must have a row and a column for each cell of the env, at "
                f"least [{row + 1}, {column + 1}], got [{self.num_rows}, "
                f"{self.num_columns}]"
            )


class WaypointTruth(GrowingSlots, KeyedTransform):
    """Marks *spurious* waypoints: an earlier one of the episode is near, heading alike.

    The similarity has failed to recognise the place. It reads privileged keys and is
    for evaluation.

    Args:
        distance: how far away, in map units, still is near.
        angle: how many degrees of difference still are alike, in [0, 180].
        in_keys: keys of the position, float32 ``[*B, 2]``, the heading in degrees,
            float32 ``[*B, 1]``, and of new waypoints, bool ``[*B, 1]``.
        out_keys: key of the spurious ones, bool ``[*B, 1]``.

    Examples:
        >>> def at(x, heading):
        ...     pose = {keys.POSITION: [x, 0.0], keys.HEADING: [heading]}
        ...     return TensorDict({**pose, keys.IS_NEW_WAYPOINT: [True]})
        >>> truth = WaypointTruth(distance=96)
        >>> start = truth._reset(TensorDict(), at(0.0, 350.0))
        >>> truth._step(TensorDict(), at(96.0, 35.0))[keys.SPURIOUS_WAYPOINT].item()
        True
    """

    default_keys = (
        [keys.POSITION, keys.HEADING, keys.IS_NEW_WAYPOINT],
        [keys.SPURIOUS_WAYPOINT],
    )
    poses: Tensor
    num_waypoints: Tensor

    def __init__(
        self,
        distance: float,
        angle: float = 45.0,
        *,
        in_keys: Keys = None,
        out_keys: Keys = None,
    ) -> None:
        if not distance >= 0:
            raise ValueError(f"distance must be at least 0 map units, got {distance}")
        if not 0 <= angle <= 180:
            raise ValueError(f"angle must be in [0, 180] degrees, got {angle}")
        super().__init__(in_keys, out_keys)
        self.distance = distance
        self.angle = angle
        # x, y and heading of each waypoint, [N, A, 3], and their number, [N].
        self.register_buffer("poses", torch.empty(0, 0, 3))
        self.register_buffer("num_waypoints", torch.empty(0, dtype=torch.int64))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        is_new = read_entry(tensordict_reset, self.in_keys[2])
        move_to(self, is_new.device)
        rows = restarting_rows(self, tensordict, is_new.shape[:-1], is_new.device)
        rows = rows.reshape(-1)
        if len(self.num_waypoints) != len(rows):
            self.poses = self.poses.new_zeros(len(rows), self.poses.shape[1], 3)
            self.num_waypoints = self.num_waypoints.new_zeros(len(rows))
        self.num_waypoints = self.num_waypoints * ~rows
        return self._judge(tensordict_reset, rows)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        is_new = read_entry(next_tensordict, self.in_keys[2])
        require_reset(self.num_waypoints.shape, [is_new.numel()])
        return self._judge(next_tensordict)

    def _judge(
        self, tensordict: TensorDictBase, rows: Tensor | bool = True
    ) -> TensorDictBase:
        entries = [read_entry(tensordict, key) for key in self.in_keys]
        position, heading, flag = entries
        pose = torch.cat([position, heading], -1).reshape(-1, 3)
        is_new = flag.reshape(-1) & rows
        self._make_room("poses", self.num_waypoints)
        slot = torch.arange(self.poses.shape[1], device=pose.device)
        apart = self.poses - pose.unsqueeze(1)
        near = apart[..., :2].norm(dim=-1) <= self.distance
        turned = ((apart[..., 2] + 180) % 360 - 180).abs() <= self.angle
        known = near & turned & (slot < self.num_waypoints.unsqueeze(-1))
        spurious = is_new & known.any(-1)
        place = (torch.arange(len(pose), device=pose.device), self.num_waypoints)
        self.poses[place] = torch.where(is_new.unsqueeze(-1), pose, self.poses[place])
        self.num_waypoints = self.num_waypoints + is_new
        return tensordict.set(self.out_keys[0], spurious.reshape(flag.shape))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for key, length in zip(self.in_keys, (2, 1, 1), strict=True):
            flag = find_spec(observation_spec, key, length=length)
        spec = Binary(1, flag.shape, flag.device, torch.bool)
        return observation_spec.set(self.out_keys[0], spec)
