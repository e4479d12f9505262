"""`PolicyPixels`: the small copy of the view that a policy looks at."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.data import Bounded, Composite
from torchrl.envs.transforms import Transform

from toponav.keys import PIXELS, POLICY_PIXELS


class PolicyPixels(Transform):
    """Copies views at another size, averaged so that nothing small flickers.

    Each new pixel is a mean of those under it, weighted by their distance to its
    centre. uint8 stays uint8, which has a fast path on the CPU: half a millisecond for
    16 views of 160x120. Unlike `torchrl.envs.Resize` it needs no torchvision and takes
    height, width, channels; unlike `AreaDownsample` any size.

    Reference:
        The paper, "Model implementation": 84x84 RGB.

    Args:
        size: height and width in pixels of the copy.
        in_keys: keys of the views, ``pixels`` unless given; uint8 or floating point,
            ``[*B, H, W, C]``.
        out_keys: keys of the copies, ``policy_pixels`` unless given.

    Raises:
        ValueError: if an argument is out of range, and when the env's specs are read,
            if a view is missing or is no image.

    Examples:
        >>> from tensordict import TensorDict
        >>> views = torch.zeros(2, 120, 160, 3, dtype=torch.uint8)
        >>> data = PolicyPixels()(TensorDict({"pixels": views}, [2]))
        >>> data["policy_pixels"].shape, data["policy_pixels"].dtype
        (torch.Size([2, 84, 84, 3]), torch.uint8)

    Shape notation:
        B: batch of environments.  H, W, C: height, width, channels.
    """

    def __init__(
        self,
        size: tuple[int, int] = (84, 84),
        *,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        if len(size) != 2 or min(size) < 1:
            raise ValueError(f"size must be two numbers of at least 1, got {size}")
        super().__init__(
            in_keys=[PIXELS] if in_keys is None else in_keys,
            out_keys=[POLICY_PIXELS] if out_keys is None else out_keys,
        )
        if len(self.in_keys) != len(self.out_keys):
            raise ValueError(f"out_keys must match {self.in_keys}, got {self.out_keys}")
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
            view = observation_spec[in_key]
            if len(view.shape) < 3:
                raise ValueError(f"{in_key!r} must be images, got {list(view.shape)}")
            shape = (*view.shape[:-3], *self.size, view.shape[-1])
            low, high = (0, 255) if view.dtype == torch.uint8 else (0.0, 1.0)
            observation_spec[out_key] = Bounded(
                low, high, shape=shape, dtype=view.dtype, device=view.device
            )
        return observation_spec
