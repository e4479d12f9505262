"""Buffers that hold one row per env, whose number is known at the first reset."""

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform


class ResizableBuffers:
    """Mixin of modules whose buffers take shape and dtype of the state they load."""

    def _load_from_state_dict(
        self, state_dict: Mapping[str, object], prefix: str, *args: object
    ) -> None:
        module: Any = self
        for name, buffer in list(module.named_buffers(recurse=False)):
            stored = state_dict.get(prefix + name)
            if isinstance(stored, Tensor):
                empty = buffer.new_empty(stored.shape, dtype=stored.dtype)
                setattr(self, name, empty)
        super()._load_from_state_dict(state_dict, prefix, *args)  # type: ignore[misc]


def restarting_rows(
    transform: Transform,
    tensordict: TensorDictBase,
    shape: torch.Size,
    device: torch.device,
) -> Tensor:
    """Which envs begin a new episode in this reset, bool ``[*B]``: all if unmasked."""
    keys = ["_reset"] if transform.parent is None else transform.parent.reset_keys
    masks = [tensordict.get(key, None) for key in keys]
    rows = [mask.reshape(*shape, -1).any(-1) for mask in masks if mask is not None]
    if not rows:
        return torch.ones(shape, dtype=torch.bool, device=device)
    return torch.stack(rows).any(0).to(device)


def grow_slots(buffer: Tensor, num_slots: int, capacity: int | None = None) -> Tensor:
    """``buffer`` ``[N, A, ...]`` with room for ``num_slots`` per env, at least doubled.

    Examples:
        >>> grow_slots(torch.ones(1, 5), 6)
        tensor([[1., 1., 1., 1., 1., 0., 0., 0., 0., 0.]])
    """
    slots = buffer.shape[1]
    if num_slots <= slots:
        return buffer
    room = max(num_slots, 2 * slots, 8)
    room = room if capacity is None else min(room, capacity)
    grown = buffer.new_zeros(buffer.shape[0], room, *buffer.shape[2:])
    grown[:, :slots] = buffer
    return grown


class ReadSchedule:
    """When to read numbers of a device: on the CPU always, elsewhere now and then."""

    #: Decisions from one reading to the next where it costs time.
    EVERY = 16

    def __init__(self) -> None:
        self._since = 0

    def is_free(self, device: torch.device) -> bool:
        """Whether reading waits for nothing."""
        return device.type == "cpu"

    def is_due(self, device: torch.device) -> bool:
        """Whether to read in this decision; ask once in each."""
        self._since += 1
        if not self.is_free(device) and self._since < self.EVERY:
            return False
        self._since = 0
        return True
