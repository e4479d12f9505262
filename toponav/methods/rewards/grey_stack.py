"""`GreyStack`: the last views of an episode, small and grey."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

from toponav.keys import FRAME_STACK, PIXELS, POLICY_PIXELS, read_entry
from toponav.methods.rewards.rnd import LUMA
from toponav.parts import needs_env
from toponav.transforms import PolicyPixels, SeesLastViews
from toponav.views import ChannelOrder, as_given, channels_last


class GreyStack(SeesLastViews, Transform):
    """Writes the last views of an episode, small and grey; black before its first one.

    They ride in the tensordict: the newest is last, and a step adds to those before.

    Args:
        size: height and width of the small views in pixels.
        frames: number K of views.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, 3, H, W]`` and stacks ``[*B,
            K, H', W']``.

    Examples:
        >>> start = TensorDict({"pixels": torch.full((1, 8, 8, 3), 200).byte()}, [1])
        >>> stack = GreyStack((1, 1), frames=3)._reset(None, start)["frame_stack"]
        >>> stack.flatten()
        tensor([  0,   0, 200], dtype=torch.uint8)
    """

    luma: Tensor

    def __init__(
        self, size: tuple[int, int], frames: int, *, channels: ChannelOrder = "HWC"
    ) -> None:
        super().__init__(in_keys=[PIXELS], out_keys=[FRAME_STACK])
        if frames < 1:
            raise ValueError(f"frames must be at least 1, got {frames}.")
        self.frames = frames
        self.register_buffer("luma", torch.tensor(LUMA), persistent=False)
        self.shrink = PolicyPixels(size, channels=channels)

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        return self._append(read_entry(tensordict, FRAME_STACK), next_tensordict)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # Rows that go on keep what they had: TorchRL merges this by the mask.
        shape = self._shape(tensordict_reset.batch_size)
        black = torch.zeros(shape, dtype=torch.uint8, device=tensordict_reset.device)
        return self._append(black, tensordict_reset)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        raise needs_env(self)

    def _append(self, earlier: Tensor, following: TensorDictBase) -> TensorDictBase:
        channels = self.shrink.channels
        small = self.shrink._apply_transform(read_entry(following, PIXELS))
        small = channels_last(small, channels).float()
        self.luma = self.luma.to(small.device)
        grey = small @ self.luma
        newest = grey.round().to(torch.uint8).unsqueeze(-1)
        stack = torch.cat([channels_last(earlier, channels)[..., 1:], newest], -1)
        return following.set(FRAME_STACK, as_given(stack, channels).contiguous())

    def _shape(self, batch: Sequence[int]) -> tuple[int, ...]:
        size, frames = self.shrink.size, self.frames
        if self.shrink.channels == "HWC":
            return (*batch, *size, frames)
        return (*batch, frames, *size)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        # It refuses what are no views, in words.
        small = self.shrink.transform_observation_spec(observation_spec.clone())
        view: TensorSpec = small[POLICY_PIXELS]
        spec = Unbounded(self._shape(view.shape[:-3]), view.device, torch.uint8)
        return observation_spec.set(FRAME_STACK, spec)
