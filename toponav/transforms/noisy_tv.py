"""NoisyTV: a patch of fresh noise in one quadrant of the view."""

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, get_args

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs.transforms import Transform

from toponav.keys import PIXELS
from toponav.transforms.episode_buffers import match_buffers, reset_rows

Quadrant = Literal["top_left", "top_right", "bottom_left", "bottom_right"]
Scale = Literal["quadrant", "native"]
ChannelOrder = Literal["HWC", "CHW"]
#: ``law(shape, generator)`` returns uint8 intensities of that shape, on the CPU.
NoiseLaw = Callable[[tuple[int, ...], torch.Generator], Tensor]

QUADRANTS: tuple[str, ...] = get_args(Quadrant)


def uniform_noise(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Draw every intensity 0..255 equally often: the paper's law."""
    return torch.randint(256, shape, generator=generator, dtype=torch.uint8)


def binary_noise(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Draw 0 and 255 equally often."""
    return 255 * torch.randint(2, shape, generator=generator, dtype=torch.uint8)


def normal_noise(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Draw around 127.5 with a standard deviation of 50, cut at 0 and 255."""
    noise = torch.randn(shape, generator=generator) * 50 + 127.5
    return noise.round_().clamp_(0, 255).to(torch.uint8)


NOISE_LAWS: Mapping[str, NoiseLaw] = {
    "binary": binary_noise,
    "normal": normal_noise,
    "uniform": uniform_noise,
}


class NoisyTV(Transform):
    """Covers one quadrant of the view with noise that is fresh in each decision.

    The noise does not depend on what the agent does, so a curiosity that pays
    for the unpredictable keeps staring at it. Per env, the quadrant is drawn
    anew in each episode and stays there until the next one. All ``in_keys`` of
    an env show the same noise in the same quadrant, so that a full view and a
    small one of the same scene agree. The views are copied, never painted in
    place.

    One generator serves the whole batch, on the CPU whatever the device of the
    data: the same seed and the same resets give the same noise everywhere.
    Copies in several workers need different seeds, or they show the same noise.

    Reference:
        "A target-driven visual navigation method based on intrinsic motivation
        exploration and space topological cognition", '"Noisy-TV" experiment':
        21x21, uniform in [0, 255], fixed within an episode.

    Args:
        in_keys: keys of the views, ``pixels`` unless given; uint8 in ``[0, 255]``
            or floating point in ``[0, 1]``, ``[*B, ..., H, W, C]`` or
            ``[*B, ..., C, H, W]``.
        out_keys: keys of the noisy views, the ``in_keys`` unless given.
        size: side of the noise in noise pixels.
        quadrant: where the noise is, or ``None`` to draw it in each episode.
        scale: ``"quadrant"`` enlarges the noise (nearest neighbour) until it
            fills the quadrant, ``"native"`` shows it pixel for pixel in the
            middle of the quadrant.
        law: ``"uniform"``, ``"binary"``, ``"normal"`` or a callable
            ``law(shape, generator) -> uint8 [*shape]``.
        channels: place of the channel dimension in every view.
        seed: of the noise and the quadrants; ``None`` takes one from the
            operating system.

    Raises:
        ValueError: if an argument is out of range, and when the env's specs are
            read, if a view is missing, is not an image or is too small.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from torchrl.testing.mocking_classes import FastImageEnv
        >>> env = FastImageEnv(img_shape=(3, 84, 84))
        >>> tv = NoisyTV(quadrant="top_left", channels="CHW", seed=0)
        >>> views = TransformedEnv(env, tv).rollout(5)["pixels"]
        >>> (views[0] != views[1]).any(0).nonzero().amax(0) + 1  # quadrant
        tensor([42, 42])

    Shape notation:
        B: batch of environments.  H, W, C: height, width, channels.
    """

    corner: Tensor

    def __init__(
        self,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
        *,
        size: int = 21,
        quadrant: Quadrant | None = None,
        scale: Scale = "quadrant",
        law: str | NoiseLaw = "uniform",
        channels: ChannelOrder = "HWC",
        seed: int | None = None,
    ) -> None:
        if size < 1:
            raise ValueError(f"size must be at least 1, got {size}")
        if quadrant is not None and quadrant not in QUADRANTS:
            raise ValueError(f"quadrant must be one of {QUADRANTS}, got {quadrant!r}")
        if scale not in get_args(Scale):
            raise ValueError(f"scale must be one of {get_args(Scale)}, got {scale!r}")
        if channels not in get_args(ChannelOrder):
            raise ValueError(f"channels must be 'HWC' or 'CHW', got {channels!r}")
        if isinstance(law, str) and law not in NOISE_LAWS:
            raise ValueError(f"law must be one of {tuple(NOISE_LAWS)}, got {law!r}")
        super().__init__(in_keys=[PIXELS] if in_keys is None else in_keys)
        self.out_keys = self.in_keys if out_keys is None else out_keys
        if len(self.in_keys) != len(self.out_keys):
            raise ValueError(f"out_keys must match {self.in_keys}, got {self.out_keys}")
        self.size = size
        self.quadrant = quadrant
        self.scale = scale
        self.law: NoiseLaw = NOISE_LAWS[law] if isinstance(law, str) else law
        self.channels = channels
        self.generator = torch.Generator()
        self.set_seed(seed)
        # Index into QUADRANTS of every env, [*B]; B is known at the first reset.
        self.register_buffer("corner", torch.empty(0, dtype=torch.int64))

    def set_seed(self, seed: int | None) -> None:
        """Restart the generator; ``None`` takes a seed from the operating system."""
        if seed is None:
            self.generator.seed()
        else:
            self.generator.manual_seed(seed)

    def get_extra_state(self) -> Tensor:
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        self.generator.set_state(state.cpu())

    def _load_from_state_dict(
        self, state_dict: Mapping[str, object], prefix: str, *args: object
    ) -> None:
        match_buffers(self, state_dict, prefix)
        super()._load_from_state_dict(state_dict, prefix, *args)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        shape = tensordict_reset.batch_size
        reset_keys = ["_reset"] if self.parent is None else self.parent.reset_keys
        if self.corner.shape == shape:
            rows = reset_rows(tensordict, reset_keys, shape).to(self.corner.device)
            drawn = self._draw_corners(shape).to(self.corner.device)
            self.corner = torch.where(rows, drawn, self.corner)
        return self._call(tensordict_reset)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        shape = next_tensordict.batch_size
        if self.corner.shape != shape:
            self.corner = self._draw_corners(shape)
        noises: dict[int, Tensor] = {}
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            views = next_tensordict.get(in_key)
            count = views.shape[-1 if self.channels == "HWC" else -3]
            if count not in noises:
                noises[count] = self._draw_noise(shape.numel(), count)
            next_tensordict.set(out_key, self._paint(views, noises[count]))
        return next_tensordict

    def _draw_corners(self, shape: torch.Size) -> Tensor:
        if self.quadrant is not None:
            return torch.full(shape, QUADRANTS.index(self.quadrant))
        return torch.randint(len(QUADRANTS), shape, generator=self.generator)

    def _draw_noise(self, num_envs: int, num_channels: int) -> Tensor:
        shape = (num_envs, self.size, self.size, num_channels)
        noise = self.law(shape, self.generator)
        if noise.dtype is not torch.uint8 or noise.shape != shape:
            raise ValueError(
                f"law must return uint8 {shape}, got {noise.dtype} {tuple(noise.shape)}"
            )
        return noise

    def _paint(self, views: Tensor, noise: Tensor) -> Tensor:
        """Return ``views`` with ``noise`` in each env's quadrant.

        Args:
            views: ``[*B, ..., H, W, C]`` or ``[*B, ..., C, H, W]``.
            noise: uint8 ``[prod(B), size, size, C]``.
        """
        painted = views.clone(memory_format=torch.contiguous_format)
        flat = painted.reshape(-1, *painted.shape[-3:])
        if self.channels == "CHW":
            flat = flat.movedim(-3, -1)
        height, width = flat.shape[1] // 2, flat.shape[2] // 2
        # Four quadrants as a view [N, 2, 2, H/2, W/2, C]; an odd last row or
        # column belongs to none of them.
        corners = flat[:, : 2 * height, : 2 * width]
        corners = corners.unflatten(2, (2, width)).unflatten(1, (2, height))
        corners = corners.movedim(3, 2)
        noise = noise.to(views.device)
        if self.scale == "quadrant":
            down = torch.arange(height, device=views.device) * self.size // height
            right = torch.arange(width, device=views.device) * self.size // width
            noise = noise.index_select(1, down).index_select(2, right)
        else:
            top, left = (height - self.size) // 2, (width - self.size) // 2
            corners = corners[..., top : top + self.size, left : left + self.size, :]
        if views.is_floating_point():
            noise = noise.to(views.dtype) / 255
        corner = self.corner.to(views.device).reshape(-1)
        each = len(flat) // max(len(corner), 1)
        if each > 1:  # several views per env, as of several agents
            corner = corner.repeat_interleave(each)
            noise = noise.repeat_interleave(each, dim=0)
        row = torch.arange(len(flat), device=views.device)
        corners[row, corner // 2, corner % 2] = noise
        return painted

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            if in_key not in observation_spec.keys(True, True):
                raise ValueError(
                    f"in_keys must be observations of the env, got {in_key!r}"
                )
            spec = observation_spec[in_key]
            self._check_view(in_key, spec.shape, spec.dtype)
            observation_spec[out_key] = spec.clone()
        return observation_spec

    def _check_view(
        self, key: NestedKey, shape: torch.Size, dtype: torch.dtype
    ) -> None:
        if dtype is not torch.uint8 and not dtype.is_floating_point:
            raise ValueError(f"{key!r} must be uint8 or floating point, got {dtype}")
        if len(shape) < 3:
            raise ValueError(f"{key!r} must be {self.channels} images, got {shape}")
        height, width = shape[-3:-1] if self.channels == "HWC" else shape[-2:]
        smallest = 2 if self.scale == "quadrant" else 2 * self.size
        if min(height, width) < smallest:
            raise ValueError(
                f"{key!r} must be at least {smallest}x{smallest} for size={self.size} "
                f"and scale={self.scale!r}, got {height}x{width}"
            )
