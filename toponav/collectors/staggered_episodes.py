"""`StaggeredEpisodes`: environments whose episodes do not end together."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from toponav.keys import DONE, TRUNCATED


class StaggeredEpisodes(Transform):
    """Cuts the first episode of each environment short, each at another length.

    Otherwise a learner would first see only beginnings, then only ends. Row ``e`` of
    ``E`` is truncated after ``length * (e + 1) / E`` decisions the first time, rounded
    up, of the ``length >= 1`` of an episode. A reset of all rows starts over.
    """

    #: int64 [E]; decisions until the cut, 0 once an environment has had its own.
    left: Tensor

    def __init__(self, length: int) -> None:
        if length < 1:
            raise ValueError(f"length must be at least 1, got {length}")
        super().__init__()
        self.length = length
        empty = torch.empty(0, dtype=torch.int64)
        self.register_buffer("left", empty, persistent=False)

    def get_extra_state(self) -> Tensor:
        return self.left

    def set_extra_state(self, state: Tensor) -> None:
        self.left = state.to(self.left.device)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        shape = tensordict_reset.batch_size
        rows = tensordict.get("_reset", None)
        if rows is None or self.left.shape != shape:
            num = max(shape.numel(), 1)
            row = torch.arange(1, num + 1, device=tensordict_reset.get(DONE).device)
            self.left = (row * self.length).add(num - 1).div(num, rounding_mode="floor")
            self.left = self.left.reshape(shape)
        else:
            # A first episode that ended by itself needs no cut any more.
            self.left = self.left * ~rows.reshape(shape)
        return tensordict_reset

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        cut = (self.left == 1).unsqueeze(-1)
        self.left = (self.left - 1).clamp(min=0)
        for key in (DONE, TRUNCATED):
            next_tensordict.set(key, next_tensordict.get(key) | cut)
        return next_tensordict
