"""`PolicyPixels`: the small copy of the view that a policy looks at."""

import torch
from tensordict import NestedKey
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.data import Bounded, TensorSpec

from toponav.keys import PIXELS, POLICY_PIXELS
from toponav.transforms.specs import Keys, ViewTransform


class PolicyPixels(ViewTransform):
    """Writes views at another size, averaged so that nothing small flickers.

    uint8 stays uint8. Unlike `torchrl.envs.Resize` it needs no torchvision and takes
    height, width, channels; unlike `AreaDownsample` any size.

    Reference:
        The paper, "Model implementation": 84x84 RGB.

    Args:
        size: height and width of the copy in pixels.
        in_keys: keys of the views, ``[*B, H, W, C]``, ``pixels`` unless given.
        out_keys: keys of the copies, ``policy_pixels`` unless given.

    Examples:
        >>> from tensordict import TensorDict
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
    ) -> None:
        if len(size) != 2 or min(size) < 1:
            raise ValueError(f"size must be two numbers of at least 1, got {size}")
        super().__init__(in_keys or [PIXELS], out_keys or [POLICY_PIXELS])
        self.size = tuple(size)

    def _apply_transform(self, obs: Tensor) -> Tensor:
        batch = obs.shape[:-3]
        # Channels last in memory: no pixel moves.
        planes = obs.reshape(-1, *obs.shape[-3:]).permute(0, 3, 1, 2)
        is_bytes = obs.dtype == torch.uint8
        if is_bytes and obs.device.type != "cpu":
            planes = planes.float()
        small = F.interpolate(
            planes, self.size, mode="bilinear", align_corners=False, antialias=True
        )
        if is_bytes and small.dtype != torch.uint8:
            small = small.round_().clamp_(0, 255).to(torch.uint8)
        small = small.permute(0, 2, 3, 1)
        return small.reshape(*batch, *small.shape[1:]).contiguous()

    def _spec_of(self, key: NestedKey, view: TensorSpec) -> TensorSpec:
        shape = (*view.shape[:-3], *self.size, view.shape[-1])
        low, high = (0, 255) if view.dtype == torch.uint8 else (0.0, 1.0)
        return Bounded(low, high, shape=shape, dtype=view.dtype, device=view.device)
