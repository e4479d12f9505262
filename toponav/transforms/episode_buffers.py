"""Buffers that hold one row per env, whose number is known at the first reset."""

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.envs.transforms import Transform


class ResizableBuffers:
    """Mixin of modules whose buffers take shape and dtype of the state they load."""

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any
    ) -> None:
        module: Any = self
        for name, buffer in list(module.named_buffers(recurse=False)):
            stored = state_dict.get(prefix + name)
            if isinstance(stored, Tensor):
                setattr(self, name, torch.empty_like(stored, device=buffer.device))
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
    """``buffer [N, A, ...]`` with room for ``num_slots`` per env, at least doubled."""
    slots = buffer.shape[1]
    if num_slots <= slots:
        return buffer
    room = max(num_slots, 2 * slots, 8)
    room = room if capacity is None else min(room, capacity)
    return F.pad(buffer, [0, 0] * (buffer.ndim - 2) + [0, room - slots])
