"""Policies that see nothing: lower ends of the scale.

- :class:`RandomPolicy` draws every action anew.
- :class:`StickyPolicy` mostly repeats its last one.
"""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from toponav.keys import ACTION


class RandomPolicy(TensorDictModuleBase):
    """Draws each action uniformly.

    Args:
        num_actions: how many actions there are.
        seed: of the draws.

    Raises:
        ValueError: if ``num_actions < 1``.

    Examples:
        >>> from tensordict import TensorDict
        >>> RandomPolicy(seed=0)(TensorDict(batch_size=[4]))["action"].shape
        torch.Size([4])
    """

    in_keys: list[NestedKey] = []
    out_keys = [ACTION]

    def __init__(self, num_actions: int = 6, *, seed: int = 0) -> None:
        if num_actions < 1:
            raise ValueError(f"num_actions must be at least 1, got {num_actions}")
        super().__init__()
        self.num_actions = num_actions
        self.generator = torch.Generator().manual_seed(seed)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = tensordict.batch_size
        action = torch.randint(self.num_actions, shape, generator=self.generator)
        return tensordict.set(ACTION, action.to(tensordict.device))


class StickyPolicy(TensorDictModuleBase):
    """Repeats its last action with probability ``stickiness``, else draws anew.

    It walks farther than :class:`RandomPolicy`, which mostly trembles on the
    spot. An episode's end does not make it forget: what is carried over is one
    action, and only with probability ``stickiness``.

    Args:
        stickiness: probability of the last action, in [0, 1].
        weights: how often each action is drawn, relative to the others; forward
            is favoured unless given, six equal ones walk less far.
        seed: of the draws.

    Raises:
        ValueError: if ``stickiness`` is out of range or ``weights`` are not
            positive somewhere and negative nowhere.

    Examples:
        >>> from tensordict import TensorDict
        >>> policy = StickyPolicy(1.0, seed=0)
        >>> first, second = (
        ...     policy(TensorDict(batch_size=[4]))["action"] for _ in range(2)
        ... )
        >>> bool((first == second).all())
        True
    """

    in_keys: list[NestedKey] = []
    out_keys = [ACTION]
    weights: Tensor
    last: Tensor

    def __init__(
        self,
        stickiness: float = 0.75,
        *,
        weights: Sequence[float] = (3.0, 1.0, 1.0, 1.0, 1.5, 1.5),
        seed: int = 0,
    ) -> None:
        if not 0 <= stickiness <= 1:
            raise ValueError(f"stickiness must be in [0, 1], got {stickiness}")
        if min(weights, default=0) < 0 or sum(weights) <= 0:
            raise ValueError(f"weights must be positive, got {tuple(weights)}")
        super().__init__()
        self.stickiness = stickiness
        self.generator = torch.Generator().manual_seed(seed)
        weighting = torch.tensor(weights, dtype=torch.float32)
        self.register_buffer("weights", weighting, persistent=False)
        # The last actions, [*B]; B is known at the first call.
        empty = torch.empty(0, dtype=torch.int64)
        self.register_buffer("last", empty, persistent=False)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = tensordict.batch_size
        drawn = torch.multinomial(
            self.weights.cpu(),
            shape.numel(),
            replacement=True,
            generator=self.generator,
        ).reshape(shape)
        if self.last.shape == shape:
            keep = torch.rand(shape, generator=self.generator) < self.stickiness
            drawn = torch.where(keep, self.last, drawn)
        self.last = drawn
        return tensordict.set(ACTION, drawn.to(tensordict.device))
