"""What the batched environments have in common: specs, masks and seeds of rows."""

from collections.abc import Mapping

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from toponav.worlds import WorldSpec


def set_world(
    env: EnvBase, world: WorldSpec, observations: Mapping[str, TensorSpec] | None = None
) -> None:
    """Give an environment a world, its specs, and those of other ``observations``."""
    shape, device = env.batch_size, env.device
    env.world = world
    view = (*shape, *world.view_size, 3)
    env.observation_spec = Composite(
        # All values of a byte: TorchRL copies and compares the limits of a bounded
        # spec, pixel by pixel, whenever it looks at one.
        pixels=Unbounded(view, device=device, dtype=torch.uint8),
        **(observations or {}),
        shape=shape,
        device=device,
    )
    env.action_spec = Categorical(world.num_actions, shape=shape, device=device)
    env.reward_spec = Unbounded((*shape, 1), device=device)
    flag = Binary(1, (*shape, 1), dtype=torch.bool, device=device)
    env.done_spec = Composite(
        {key: flag.clone() for key in ("done", "terminated", "truncated")},
        shape=shape,
        device=device,
    )


def masked_rows(tensordict: TensorDictBase | None, key: str, size: int) -> list[int]:
    """The rows that a mask (``_reset``, ``_step``) asks for; all without one."""
    mask = None if tensordict is None else tensordict.get(key, None)
    if mask is None:
        return list(range(size))
    rows: list[int] = np.flatnonzero(mask.cpu().numpy()).tolist()
    return rows


def read_actions(
    tensordict: TensorDictBase, rows: list[int], env: EnvBase
) -> list[int]:
    """The numbers of the actions of all rows; those of ``rows`` are looked at.

    Raises:
        KeyError: if the tensordict has none.
        ValueError: if they are no numbers ``[*B]`` or ``[*B, 1]`` of actions.
    """
    action: Tensor | None = tensordict.get("action", None)
    if action is None:
        raise KeyError("a step must have 'action', which a policy writes, got none")
    shape, num_actions = env.batch_size, env.world.num_actions
    if action.shape not in (shape, (*shape, 1)) or action.is_floating_point():
        rule = f"action must be integers of the shape {list(shape)}"
        hint = "a policy for one-hot actions has one_hot=False for these"
        got = f"{action.dtype} {list(action.shape)}"
        raise ValueError(f"{rule} ({hint}), got {got}")
    numbers: list[int] = action.reshape(-1).tolist()
    if bad := [numbers[row] for row in rows if not 0 <= numbers[row] < num_actions]:
        raise ValueError(f"action must be in [0, {num_actions}), got {bad[0]}")
    return numbers


def episode_streams(seed: int | None, size: int) -> list[np.random.Generator]:
    """A stream of episodes for each row; ``None`` draws a seed."""
    sequences = np.random.SeedSequence(seed).spawn(size)
    return [np.random.default_rng(sequence) for sequence in sequences]
