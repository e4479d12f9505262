"""Smaller views: `AreaDownsample` for the networks, `PolicyPixels` for the policy.

Reference:
    The paper, "Model implementation": 84x84 RGB.
"""

import torch
from tensordict import NestedKey
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.data import Bounded, TensorSpec, Unbounded

from toponav import keys
from toponav.transforms.specs import Keys, ViewTransform
from toponav.views import (
    ChannelOrder,
    as_given,
    channels_last,
    check_views,
    view_size,
)


class AreaDownsample(ViewTransform):
    """Writes views shrunk by the mean over ``factor`` x ``factor`` pixels.

    uint8 stays uint8, rounded to the nearest (halves up).

    Args:
        in_keys: keys of the views, ``pixels`` unless given, see ``channels``.
        out_keys: keys of the small views, ``network_pixels`` unless given.
        factor: how many pixels become one, in height and in width; must divide both.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, C, H, W]``.

    Examples:
        >>> image = torch.tensor([[0, 0, 7, 7], [1, 1, 7, 7]], dtype=torch.uint8)
        >>> views = TensorDict({"pixels": image.reshape(1, 2, 4, 1)}, [1])
        >>> AreaDownsample()(views)["network_pixels"].flatten()
        tensor([1, 7], dtype=torch.uint8)
    """

    def __init__(
        self,
        in_keys: Keys = None,
        out_keys: Keys = None,
        *,
        factor: int = 2,
        channels: ChannelOrder = "HWC",
    ) -> None:
        if factor < 1:
            raise ValueError(f"factor must be at least 1, got {factor}")
        in_keys, out_keys = in_keys or [keys.PIXELS], out_keys or [keys.NETWORK_PIXELS]
        super().__init__(in_keys, out_keys, channels=channels)
        self.factor = factor

    def _apply_transform(self, obs: Tensor) -> Tensor:
        check_views("views", obs.shape, self.channels)
        if self.factor == 1:
            return obs
        small = self._means(channels_last(obs, self.channels))
        return as_given(small, self.channels).contiguous()

    def _means(self, obs: Tensor) -> Tensor:
        *batch, height, width, channels = obs.shape
        factor, is_bytes = self.factor, obs.dtype == torch.uint8
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
        if any(side % self.factor for side in view_size(view.shape, self.channels)):
            rule = f"{key!r} must have sides that are multiples of {self.factor}"
            raise ValueError(f"{rule}, got {list(view.shape)}")
        # The bounds of a square's first pixel stand for those of the mean.
        if self.channels == "HWC":
            return view[..., :: self.factor, :: self.factor, :]
        return view[..., :: self.factor, :: self.factor]


class PolicyPixels(ViewTransform):
    """Writes views at another size, averaged so that nothing small flickers.

    uint8 stays uint8. Unlike TorchRL's ``Resize`` it needs no torchvision.

    Args:
        size: height and width of the copy in pixels.
        in_keys: keys of the views, ``pixels`` unless given, see ``channels``.
        out_keys: keys of the copies, ``policy_pixels`` unless given.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, C, H, W]``.

    Examples:
        >>> views = torch.zeros(2, 24, 32, 3, dtype=torch.uint8)
        >>> data = PolicyPixels((10, 10))(TensorDict({"pixels": views}, [2]))
        >>> data["policy_pixels"].shape
        torch.Size([2, 10, 10, 3])
    """

    def __init__(
        self,
        size: tuple[int, int] = (84, 84),
        *,
        in_keys: Keys = None,
        out_keys: Keys = None,
        channels: ChannelOrder = "HWC",
    ) -> None:
        if len(size) != 2 or min(size) < 1:
            raise ValueError(f"size must be two numbers of at least 1, got {size}")
        in_keys, out_keys = in_keys or [keys.PIXELS], out_keys or [keys.POLICY_PIXELS]
        super().__init__(in_keys, out_keys, channels=channels)
        self.size = tuple(size)

    def _apply_transform(self, obs: Tensor) -> Tensor:
        check_views("views", obs.shape, self.channels)
        planes = obs.reshape(-1, *obs.shape[-3:])
        if self.channels == "HWC":
            # Channels last in memory: no pixel moves.
            planes = planes.permute(0, 3, 1, 2)
        is_bytes = obs.dtype == torch.uint8
        if is_bytes and obs.device.type != "cpu":
            planes = planes.float()
        small = F.interpolate(
            planes, self.size, mode="bilinear", align_corners=False, antialias=True
        )
        if is_bytes and small.dtype != torch.uint8:
            small = small.round_().clamp_(0, 255).to(torch.uint8)
        if self.channels == "HWC":
            small = small.permute(0, 2, 3, 1)
        return small.reshape(*obs.shape[:-3], *small.shape[1:]).contiguous()

    def _spec_of(self, key: NestedKey, view: TensorSpec) -> TensorSpec:
        *batch, first, _, last = view.shape
        size = (*self.size, last) if self.channels == "HWC" else (first, *self.size)
        shape = (*batch, *size)
        if view.dtype == torch.uint8:
            return Unbounded(shape, view.device, view.dtype)
        return Bounded(0.0, 1.0, shape, view.device, view.dtype)
