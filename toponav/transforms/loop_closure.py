"""`LoopClosure`: whether the agent is back where it was."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite

from toponav import keys
from toponav.keys import read_entry
from toponav.transforms.specs import (
    EpisodeMemory,
    KeyedTransform,
    Keys,
    find_spec,
    require_reset,
    restarting_rows,
)


class LoopClosure(EpisodeMemory, KeyedTransform):
    """Writes whether the agent is where it was before, having been elsewhere since.

    An earlier position of the episode counts if it is at most ``near`` away and a later
    one was more than ``far`` away. It reads the true position: for losses, and not for
    a policy. A step looks at all positions of the episode.

    Reference:
        Mirowski et al., "Learning to Navigate in Complex Environments" (2016), section
        3.3, who add up velocities instead.

    Args:
        near, far: in map units.
        in_keys: key of the position, float32 ``[*B, 2]``.
        out_keys: key of the answer, bool ``[*B, 1]``.

    Examples:
        >>> at = lambda x: TensorDict({keys.POSITION: torch.tensor([[x, 0.0]])}, [1])
        >>> loops = LoopClosure(near=1.0, far=1.5)
        >>> _ = loops._reset(at(0.0), at(0.0))
        >>> [bool(loops._step(at(0.0), at(x))[keys.LOOP_CLOSED]) for x in (2, 3, 2, 1)]
        [False, False, False, True]
    """

    default_keys = [keys.POSITION], [keys.LOOP_CLOSED]
    path: Tensor

    def __init__(
        self,
        *,
        near: float,
        far: float,
        in_keys: Keys = None,
        out_keys: Keys = None,
    ) -> None:
        if not 0 < near < far:
            got = f"{near} and {far}"
            raise ValueError(f"near must be above 0 and below far, got {got}")
        super().__init__(in_keys, out_keys)
        self.near, self.far = near, far
        # [*B, N, 2], the last N positions; infinity where an episode had not begun.
        self.register_buffer("path", torch.empty(0))

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        position = read_entry(next_tensordict, self.in_keys[0])
        require_reset(self.path.shape[:-2], position.shape[:-1])
        here = position.unsqueeze(-2)
        away = (self.path - here).norm(dim=-1)
        is_far = away.isfinite() & (away > self.far)
        # Whether the agent was far away at a position or at a later one.
        left = is_far.flip(-1).cumsum(-1).flip(-1) > 0
        closed = ((away <= self.near) & left).any(-1, keepdim=True)
        self.path = torch.cat([self.path, here], -2)
        return next_tensordict.set(self.out_keys[0], closed)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        position = read_entry(tensordict_reset, self.in_keys[0])
        shape = position.shape[:-1]
        if self.path.shape[:-2] != shape or self.path.ndim < 2:
            self.path = position.new_empty(*shape, 0, 2)
        rows = restarting_rows(self, tensordict, shape, position.device)
        self.path[rows] = torch.inf
        # What is of no running episode any more.
        length = self.path.shape[-2]
        used = self.path.isfinite().all(-1).reshape(shape.numel(), length).any(0)
        self.path = self.path[..., used.cumsum(0) > 0, :]
        start = position.masked_fill(~rows.unsqueeze(-1), torch.inf)
        self.path = torch.cat([self.path, start.unsqueeze(-2)], -2)
        # Rows that go on keep what they had: TorchRL merges this by the mask.
        none = torch.zeros(*shape, 1, dtype=torch.bool, device=position.device)
        return tensordict_reset.set(self.out_keys[0], none)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        find_spec(observation_spec, self.in_keys[0], length=2)
        shape, device = (*observation_spec.shape, 1), observation_spec.device
        flag = Binary(1, shape, device, torch.bool)
        return observation_spec.set(self.out_keys[0], flag)
