"""`AreaDownsample`: views made smaller by the mean over squares of pixels."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs.transforms import Transform

from toponav.keys import PIXELS


class AreaDownsample(Transform):
    """Shrinks views by the mean over ``factor`` x ``factor`` pixels.

    uint8 stays uint8, rounded to the nearest (halves up) in integer arithmetic: a view
    of 160x120 halved takes a quarter of the memory, and `SmallEncoder` reads it as it
    is, since it halves full views itself.

    Args:
        in_keys: keys of the views, ``pixels`` unless given; uint8 or floating point,
            ``[*B, H, W, C]``.
        out_keys: keys of the small views, the ``in_keys`` unless given.
        factor: how many pixels become one, in height and in width.

    Raises:
        ValueError: if ``factor < 1``, and when the env's specs are read, if a view is
            missing, is not an image or its sides are no multiples of ``factor``.

    Examples:
        >>> from tensordict import TensorDict
        >>> image = torch.tensor([[0, 0, 7, 7], [1, 1, 7, 7]], dtype=torch.uint8)
        >>> views = TensorDict({"pixels": image.reshape(1, 2, 4, 1)}, [1])
        >>> AreaDownsample()(views)["pixels"].flatten()
        tensor([1, 7], dtype=torch.uint8)

    Shape notation:
        B: batch of environments.  H, W, C: height, width, channels.
    """

    def __init__(
        self,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
        *,
        factor: int = 2,
    ) -> None:
        if factor < 1:
            raise ValueError(f"factor must be at least 1, got {factor}")
        super().__init__(in_keys=[PIXELS] if in_keys is None else in_keys)
        self.out_keys = self.in_keys if out_keys is None else out_keys
        self.factor = factor

    def _apply_transform(self, obs: Tensor) -> Tensor:
        *batch, height, width, channels = obs.shape
        factor = self.factor
        is_bytes = obs.dtype == torch.uint8
        wide = torch.int32 if is_bytes else obs.dtype
        if is_bytes and 255 * factor**2 < 2**15:
            wide = torch.int16  # adds up twice as fast
        # First rows, then columns: successive numbers are added together.
        rows = obs.reshape(*batch, height // factor, factor, width * channels)
        tall = rows[..., 0, :].to(wide)
        for row in range(1, factor):
            tall = tall + rows[..., row, :]
        columns = tall.reshape(
            *batch, height // factor, width // factor, factor, channels
        )
        total = columns[..., 0, :]
        for column in range(1, factor):
            total = total + columns[..., column, :]
        if not is_bytes:
            return total / factor**2
        total = total.add_(factor**2 // 2)
        if factor == 2:
            mean = total >> 2  # faster than the division
        else:
            mean = torch.div(total, factor**2, rounding_mode="floor")
        return mean.to(torch.uint8)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            if in_key not in observation_spec.keys(True, True):
                raise ValueError(
                    f"in_keys must be observations of the env, got {in_key!r}"
                )
            spec = observation_spec[in_key]
            if len(spec.shape) < 3 or any(s % self.factor for s in spec.shape[-3:-1]):
                raise ValueError(
                    f"{in_key!r} must be images whose height and width are multiples "
                    f"of {self.factor}, got {list(spec.shape)}"
                )
            # The bounds of a square's first pixel stand for those of the mean.
            observation_spec[out_key] = spec[..., :: self.factor, :: self.factor, :]
        return observation_spec
