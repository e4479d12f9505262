"""`NoisyTV`: a patch of fresh noise in one quadrant of the view."""

from collections.abc import Callable, Mapping
from typing import Literal, get_args

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from toponav.keys import PIXELS, read_entry
from toponav.parts import needs_env
from toponav.transforms.specs import (
    EpisodeMemory,
    Keys,
    SeededMixin,
    ViewTransform,
    read_views,
    require_reset,
    restarting_rows,
)
from toponav.views import OVERSHOOT, ChannelOrder, channels_last, view_size

Quadrant = Literal["top_left", "top_right", "bottom_left", "bottom_right"]
Scale = Literal["quadrant", "native"]
#: ``law(shape, generator)`` returns uint8 intensities of that shape, on the CPU.
NoiseLaw = Callable[[tuple[int, ...], torch.Generator], Tensor]

QUADRANTS: tuple[str, ...] = get_args(Quadrant)


def _integers(shape: tuple[int, ...], generator: torch.Generator, end: int) -> Tensor:
    return torch.randint(end, shape, generator=generator, dtype=torch.uint8)


def _normal(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    noise = torch.randn(shape, generator=generator) * 50 + 127.5
    return noise.round_().clamp_(0, 255).to(torch.uint8)


NOISE_LAWS: Mapping[str, NoiseLaw] = {
    "binary": lambda shape, generator: 255 * _integers(shape, generator, 2),
    "normal": _normal,
    "uniform": lambda shape, generator: _integers(shape, generator, 256),
}


class NoisyTV(SeededMixin, EpisodeMemory, ViewTransform):
    """Covers one quadrant of the view with noise that is fresh in each decision.

    The noise is a part of the world: this is the one transform that writes over its
    views, unless ``out_keys`` are given, so that whoever reads ``pixels`` sees it.
    Each episode of an env draws a quadrant and keeps it. All ``in_keys`` of an env show
    the same noise. The generator is on the CPU: the same seed and resets give the same
    noise on every device. Copies in several workers need different seeds.

    Reference:
        The paper, '"Noisy-TV" experiment': 21x21, uniform in [0, 255].

    Args:
        in_keys: keys of the views, ``pixels`` unless given; uint8 in ``[0, 255]`` or
            floating point in ``[0, 1]``, ``[*B, ..., H, W, C]``.
        out_keys: keys of the noisy views, the ``in_keys`` unless given.
        size: side of the noise in noise pixels.
        quadrant: where the noise is, or ``None`` to draw it in each episode.
        scale: ``"quadrant"`` enlarges the noise until it fills the quadrant,
            ``"native"`` shows it pixel for pixel in its middle.
        law: ``"uniform"`` in 0..255 (the paper's), ``"binary"`` (0 or 255),
            ``"normal"`` (127.5, standard deviation 50, cut), or a `NoiseLaw`.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, ..., C, H, W]``.
        seed: of noise and quadrants; ``None`` takes one from the operating system.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from torchrl.testing.mocking_classes import FastImageEnv
        >>> env = FastImageEnv(img_shape=(3, 84, 84))
        >>> tv = NoisyTV(quadrant="top_left", channels="CHW", seed=0)
        >>> views = TransformedEnv(env, tv).rollout(5)["pixels"]
        >>> (views[0] != views[1]).any(0).nonzero().amax(0) + 1  # quadrant
        tensor([42, 42])
    """

    corner: Tensor

    def __init__(
        self,
        in_keys: Keys = None,
        out_keys: Keys = None,
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
        for name, given, known in (
            ("quadrant", quadrant, (None, *QUADRANTS)),
            ("scale", scale, get_args(Scale)),
            ("law", law, tuple(NOISE_LAWS) if isinstance(law, str) else (law,)),
        ):
            if given not in known:
                raise ValueError(f"{name} must be one of {known}, got {given!r}")
        in_keys = in_keys or [PIXELS]
        super().__init__(in_keys, out_keys or in_keys, channels=channels)
        self.size = size
        self.quadrant = quadrant
        self.scale = scale
        self.law: NoiseLaw = NOISE_LAWS[law] if isinstance(law, str) else law
        self.set_seed(seed)
        # Index into QUADRANTS of every env, [*B]; B is known at the first reset.
        self.register_buffer("corner", torch.empty(0, dtype=torch.int64))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        shape = tensordict_reset.batch_size
        if self.quadrant is None:
            corner = torch.randint(len(QUADRANTS), shape, generator=self.generator)
        else:
            corner = torch.full(shape, QUADRANTS.index(self.quadrant))
        corner = corner.to(self.corner.device)
        if self.corner.shape == corner.shape:
            rows = restarting_rows(self, tensordict, corner.shape, corner.device)
            corner = torch.where(rows, corner, self.corner)
        self.corner = corner
        for key in self.in_keys:
            self._check_range(key, read_entry(tensordict_reset, key))
        return self._call(tensordict_reset)

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        require_reset(self.corner.shape, next_tensordict.batch_size)
        return self._call(next_tensordict)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        raise needs_env(self)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        noises: dict[int, Tensor] = {}
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            views = read_views(next_tensordict, in_key, self.channels)
            count = views.shape[-1 if self.channels == "HWC" else -3]
            if count not in noises:
                noises[count] = self._draw_noise(self.corner.numel(), count)
            next_tensordict.set(out_key, self._paint(views, noises[count]))
        return next_tensordict

    def _check_range(self, key: NestedKey, views: Tensor) -> None:
        """ValueError for floats in 0..255, say, in which the noise would be dark."""
        if views.is_floating_point() and bool((views > 1 + OVERSHOOT).any()):
            rule = f"{key!r} must be uint8 or floating point in [0, 1]"
            raise ValueError(f"{rule}, got {views.max():.3g}")

    def _draw_noise(self, num_envs: int, num_channels: int) -> Tensor:
        shape = (num_envs, self.size, self.size, num_channels)
        noise = self.law(shape, self.generator)
        if noise.dtype is not torch.uint8 or noise.shape != shape:
            got = f"{noise.dtype} {tuple(noise.shape)}"
            raise ValueError(f"law must return uint8 {shape}, got {got}")
        return noise

    def _paint(self, views: Tensor, noise: Tensor) -> Tensor:
        painted = views.clone(memory_format=torch.contiguous_format)
        flat = painted.reshape(-1, *painted.shape[-3:])
        flat = channels_last(flat, self.channels)
        height, width = flat.shape[1] // 2, flat.shape[2] // 2
        # Four quadrants as a view [N, 2, 2, H/2, W/2, C]; an odd last row or
        # column belongs to none of them.
        corners = flat[:, : 2 * height, : 2 * width]
        corners = corners.unflatten(2, (2, width)).unflatten(1, (2, height))
        corners = corners.movedim(3, 2)
        noise = noise.to(views.device, non_blocking=True)
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

    def _spec_of(self, key: NestedKey, view: TensorSpec) -> TensorSpec:
        if view.dtype is not torch.uint8 and not view.dtype.is_floating_point:
            raise ValueError(
                f"{key!r} must be uint8 or floating point, got {view.dtype}"
            )
        height, width = view_size(view.shape, self.channels)
        smallest = 2 if self.scale == "quadrant" else 2 * self.size
        if min(height, width) < smallest:
            raise ValueError(
                f"{key!r} must be at least {smallest}x{smallest} for size={self.size} "
                f"and scale={self.scale!r}, got {height}x{width}"
            )
        return view.clone()
