"""`AreaDownsample`: views made smaller by the mean over squares of pixels."""

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec

from toponav.keys import NETWORK_PIXELS, PIXELS
from toponav.transforms.specs import Keys, ViewTransform


class AreaDownsample(ViewTransform):
    """Writes views shrunk by the mean over ``factor`` x ``factor`` pixels.

    uint8 stays uint8, rounded to the nearest (halves up).

    Args:
        in_keys: keys of the views ``[*B, H, W, C]``, ``pixels`` unless given.
        out_keys: keys of the small views, ``network_pixels`` unless given.
        factor: how many pixels become one, in height and in width; must divide both.

    Examples:
        >>> from tensordict import TensorDict
        >>> image = torch.tensor([[0, 0, 7, 7], [1, 1, 7, 7]], dtype=torch.uint8)
        >>> views = TensorDict({"pixels": image.reshape(1, 2, 4, 1)}, [1])
        >>> AreaDownsample()(views)["network_pixels"].flatten()
        tensor([1, 7], dtype=torch.uint8)
    """

    def __init__(
        self, in_keys: Keys = None, out_keys: Keys = None, *, factor: int = 2
    ) -> None:
        if factor < 1:
            raise ValueError(f"factor must be at least 1, got {factor}")
        super().__init__(in_keys or [PIXELS], out_keys or [NETWORK_PIXELS])
        self.factor = factor

    def _apply_transform(self, obs: Tensor) -> Tensor:
        *batch, height, width, channels = obs.shape
        factor, is_bytes = self.factor, obs.dtype == torch.uint8
        if factor == 1:
            return obs
        wide = torch.int32 if is_bytes else obs.dtype
        if is_bytes and 255 * factor**2 < 2**15:
            wide = torch.int16  # adds up twice as fast
        # First rows, then columns: successive numbers are added together.
        rows = obs.reshape(*batch, height // factor, factor, width * channels)
        first, *others = rows.unbind(-2)
        tall = sum(others, start=first.to(wide))
        columns = tall.reshape(*rows.shape[:-2], width // factor, factor, channels)
        first, *others = columns.unbind(-2)
        total = sum(others, start=first)
        if not is_bytes:
            return total / factor**2
        total += factor**2 // 2
        if factor == 2:
            return (total >> 2).to(torch.uint8)  # faster than the division
        return total.div(factor**2, rounding_mode="floor").to(torch.uint8)

    def _spec_of(self, key: NestedKey, view: TensorSpec) -> TensorSpec:
        if any(side % self.factor for side in view.shape[-3:-1]):
            raise ValueError(
                f"{key!r} must be images whose height and width are multiples of "
                f"{self.factor}, got {list(view.shape)}"
            )
        # The bounds of a square's first pixel stand for those of the mean.
        return view[..., :: self.factor, :: self.factor, :]
