"""Policies that ignore what they see: lower bounds."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase

from toponav.keys import ACTION
from toponav.worlds import WorldSpec


def forward_weights(world: WorldSpec) -> tuple[float, ...]:
    """Weights of a `StickyPolicy` that favour actions that go ahead, where it is known.

    Examples:
        >>> forward_weights(WorldSpec(view_size=(64, 64), actions=("up", "down")))
        (1.0, 1.0)
    """
    if world.motion is None:
        return (1.0,) * world.num_actions
    return tuple(
        1.0 if effect.ahead <= 0 else 1.5 if effect.turn else 3.0
        for effect in world.motion.effects
    )


class RandomPolicy(TensorDictModuleBase):
    """Draws each action uniformly.

    Examples:
        >>> from tensordict import TensorDict
        >>> RandomPolicy(4, seed=0)(TensorDict(batch_size=[2]))["action"].shape
        torch.Size([2])
    """

    in_keys: list[NestedKey] = []
    out_keys = [ACTION]

    def __init__(self, num_actions: int, *, seed: int = 0) -> None:
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
    """Repeats its last action with probability ``stickiness``, else draws another.

    It gets farther than :class:`RandomPolicy`, which mostly jitters on the spot. The
    last action is carried over the end of an episode. ``weights`` are the relative
    frequencies of the actions when one is drawn; equal by default.
    """

    in_keys: list[NestedKey] = []
    out_keys = [ACTION]

    def __init__(
        self,
        num_actions: int,
        *,
        stickiness: float = 0.75,
        weights: Sequence[float] | None = None,
        seed: int = 0,
    ) -> None:
        weights = [1.0] * num_actions if weights is None else weights
        if not 0 <= stickiness <= 1:
            raise ValueError(f"stickiness must be in [0, 1], got {stickiness}")
        if len(weights) != num_actions or min(weights) < 0 or sum(weights) <= 0:
            raise ValueError(
                f"weights must be {num_actions} positive numbers, got {tuple(weights)}"
            )
        super().__init__()
        self.stickiness = stickiness
        self.generator = torch.Generator().manual_seed(seed)
        self.weights = torch.tensor(weights, dtype=torch.float32)
        # The last actions, [*B]; B is known at the first call.
        self.last = torch.empty(0, dtype=torch.int64)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = tensordict.batch_size
        drawn = torch.multinomial(
            self.weights, shape.numel(), replacement=True, generator=self.generator
        ).reshape(shape)
        if self.last.shape == shape:
            keep = torch.rand(shape, generator=self.generator) < self.stickiness
            drawn = torch.where(keep, self.last, drawn)
        self.last = drawn
        return tensordict.set(ACTION, drawn.to(tensordict.device))
