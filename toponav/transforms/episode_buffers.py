"""Buffers that hold one row per env: which rows restart, and how they are loaded.

- :func:`reset_rows`: the mask of the rows that a reset touches.
- :func:`match_buffers`: makes buffers fit the ones about to be loaded.
- :func:`grow_slots`: more room per env.
"""

from collections.abc import Mapping, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn


def reset_rows(
    tensordict: TensorDictBase, reset_keys: Sequence[NestedKey], shape: torch.Size
) -> Tensor:
    """Return which envs start a new episode in this reset.

    Args:
        tensordict: what ``env.reset`` was given; without any of ``reset_keys``
            every row restarts.
        reset_keys: the env's reset masks, each ``[*B, ...]``.
        shape: the batch shape ``[*B]`` of the rows.

    Returns:
        bool ``[*B]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> mask = torch.tensor([[True], [False]])
        >>> data = TensorDict({"_reset": mask}, batch_size=[2])
        >>> reset_rows(data, ["_reset"], data.batch_size)
        tensor([ True, False])
        >>> reset_rows(TensorDict(batch_size=[2]), ["_reset"], data.batch_size)
        tensor([True, True])
    """
    masks = [tensordict.get(key, None) for key in reset_keys]
    rows = [mask.reshape(*shape, -1).any(-1) for mask in masks if mask is not None]
    if not rows:
        return torch.ones(shape, dtype=torch.bool, device=tensordict.device)
    return torch.stack(rows).any(0)


def match_buffers(
    module: nn.Module, state_dict: Mapping[str, object], prefix: str
) -> None:
    """Give ``module``'s own buffers the shape and dtype of those in ``state_dict``.

    The number of envs is not known before the first reset, so the buffers of a
    fresh transform are empty and would refuse a state with rows in it.

    Args:
        module: the transform about to be loaded, changed in place.
        state_dict: what ``_load_from_state_dict`` was given.
        prefix: the module's prefix in it.

    Examples:
        >>> module = nn.Module()
        >>> module.register_buffer("visited", torch.empty(0))
        >>> match_buffers(module, {"net.visited": torch.ones(3)}, "net.")
        >>> module.visited.shape
        torch.Size([3])
    """
    for name, buffer in list(module.named_buffers(recurse=False)):
        stored = state_dict.get(prefix + name)
        if not isinstance(stored, Tensor):
            continue
        if (stored.shape, stored.dtype) != (buffer.shape, buffer.dtype):
            empty = buffer.new_empty(stored.shape, dtype=stored.dtype)
            setattr(module, name, empty)


def grow_slots(buffer: Tensor, num_slots: int, capacity: int | None = None) -> Tensor:
    """Return ``buffer`` with room for more per env, at least doubled.

    So a buffer that grows by one at a time is copied seldom.

    Args:
        buffer: ``[N, A, ...]``.
        num_slots: what is needed; A or less returns the buffer itself.
        capacity: never more slots than this, and at least ``num_slots``.

    Returns:
        ``[N, A', ...]``; zero where it is new.

    Examples:
        >>> grow_slots(torch.ones(1, 5), 6)
        tensor([[1., 1., 1., 1., 1., 0., 0., 0., 0., 0.]])
        >>> grow_slots(torch.ones(1, 5), 6, capacity=7).shape
        torch.Size([1, 7])
    """
    slots = buffer.shape[1]
    if num_slots <= slots:
        return buffer
    more = max(num_slots, 2 * slots, 8)
    more = more if capacity is None else min(more, capacity)
    grown = buffer.new_zeros(buffer.shape[0], more, *buffer.shape[2:])
    grown[:, :slots] = buffer
    return grown
