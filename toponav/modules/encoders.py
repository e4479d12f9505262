"""Image encoders, and `check_pixels`."""

import math
from itertools import zip_longest
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from toponav.modules.folding import FoldCache, FoldedConvolution
from toponav.views import OVERSHOOT, ChannelOrder, channels_last, check_order


def check_pixels(
    pixels: Tensor,
    *image_sizes: tuple[int, int],
    channels: ChannelOrder = "HWC",
    unit: bool = False,
) -> Tensor:
    """The pixels as ``[*B, H, W, 3]``, of such a size, uint8 or float; or ValueError.

    They are given so, or, with ``channels="CHW"``, as ``[*B, 3, H, W]``. Floats must be
    finite, and in [0, 1] for who reads them so, with ``unit``.
    """
    shapes = [(*size, 3) if channels == "HWC" else (3, *size) for size in image_sizes]
    if tuple(pixels.shape[-3:]) not in shapes:
        expected = " or ".join(str(list(shape)) for shape in shapes)
        order = f"(RGB, channels={channels!r})"
        got = list(pixels.shape)
        raise ValueError(f"pixels must end in the shape {expected} {order}, got {got}.")
    # Environments yield uint8: no number is looked at where speed counts.
    if pixels.dtype != torch.uint8:
        _check_floats(pixels, unit=unit)
    return channels_last(pixels, channels)


def _check_floats(pixels: Tensor, *, unit: bool) -> None:
    if not pixels.is_floating_point():
        raise ValueError(f"pixels must be uint8 or float in 0..1, got {pixels.dtype}.")
    if torch.compiler.is_compiling() or not pixels.numel():
        return
    limit = torch.finfo(pixels.dtype).max
    least, most = (-OVERSHOOT, 1 + OVERSHOOT) if unit else (-limit, limit)
    low, high = pixels.detach().aminmax()
    # A comparison with NaN is false.
    if not bool((low >= least) & (high <= most)):
        rule = "uint8 or float in 0..1" if unit else "finite"
        raise ValueError(f"pixels must be {rule}, got {low:.3g} to {high:.3g}.")


def compute_dtype(weight: Tensor) -> torch.dtype:
    """The dtype in which a layer computes: autocast's, or that of its weight."""
    device = weight.device.type
    if torch.is_autocast_enabled(device):
        return torch.get_autocast_dtype(device)
    return weight.dtype


def pixels_to_planes(pixels: Tensor, dtype: torch.dtype) -> Tensor:
    """Scale ``[N, H, W, 3]`` to [0, 1], seen as ``[N, 3, H, W]``: no pixel moves."""
    planes = pixels.permute(0, 3, 1, 2).to(dtype)
    return planes / 255 if pixels.dtype == torch.uint8 else planes


def use_channels_last(layer: nn.Conv2d) -> nn.Conv2d:
    """Store a convolution's weight in the memory order of `pixels_to_planes`."""
    layer.weight.data = layer.weight.data.contiguous(memory_format=torch.channels_last)
    return layer


def start_orthogonal(layer: nn.Linear | nn.Conv2d, gain: float = math.sqrt(2)) -> None:
    """Give a layer orthogonal weights, by default for a ReLU after it, and no bias."""
    nn.init.orthogonal_(layer.weight, gain)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)


def box_downsample(pixels: Tensor, dtype: torch.dtype) -> Tensor:
    """Means over 2x2 pixels in [0, 1]: ``[N, H, W, 3]`` to ``[N, 3, H / 2, W / 2]``."""
    # uint8 is added up as int16: exact, and eight times faster than converting first.
    num, height, width, channels = pixels.shape
    is_bytes = pixels.dtype == torch.uint8
    rows = pixels.reshape(num, height // 2, 2, width * channels)
    tall = rows[:, :, 0].to(torch.int16 if is_bytes else pixels.dtype) + rows[:, :, 1]
    columns = tall.reshape(num, height // 2, width // 2, 2, channels)
    total = columns[:, :, :, 0] + columns[:, :, :, 1]
    scale = 1 / (4 * 255) if is_bytes else 1 / 4
    return (total.to(dtype) * scale).permute(0, 3, 1, 2)


class SmallEncoder(nn.Module):
    """Embed full views, or views halved by `AreaDownsample`, with four convolutions.

    21.7 MFLOP for a view of the paper's size, against 1430 for ResNet-18.

    Args:
        embedding_dim: length D of the embedding.
        image_size: height and width in pixels of a full view, both even.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, 3, H, W]``.
        batch_norm: normalise after every convolution; then give the views of one
            update in one call, and compare embeddings in ``eval()`` mode only.

    Examples:
        >>> encoder = SmallEncoder(256, image_size=(60, 80)).eval()
        >>> encoder(torch.zeros(2, 3, 60, 80, 3, dtype=torch.uint8)).shape
        torch.Size([2, 3, 256])
    """

    def __init__(
        self,
        embedding_dim: int = 256,
        *,
        image_size: tuple[int, int],
        channels: ChannelOrder = "HWC",
        batch_norm: bool = True,
    ) -> None:
        super().__init__()
        self.channels = check_order(channels)
        height, width = image_size
        if height % 2 or width % 2:
            raise ValueError(f"image_size must be even, got {image_size}.")
        self.embedding_dim = embedding_dim
        self.image_size = image_size
        self.halved_size = (height // 2, width // 2)
        layers: list[nn.Module] = []
        planes, height, width = 3, height // 2, width // 2
        for out, size in ((32, 5), (48, 3), (64, 3), (96, 3)):
            convolution = nn.Conv2d(
                planes, out, size, stride=2, padding=size // 2, bias=not batch_norm
            )
            layers.append(use_channels_last(convolution))
            if batch_norm:
                layers.append(nn.BatchNorm2d(out))
            layers.append(nn.ReLU(inplace=True))
            planes, height, width = out, (height + 1) // 2, (width + 1) // 2
        self.convolutions = nn.Sequential(*layers)
        self.project = nn.Linear(planes * height * width, embedding_dim)
        self._folds = FoldCache()

    def forward(self, pixels: Tensor) -> Tensor:
        sizes = self.image_size, self.halved_size
        pixels = check_pixels(pixels, *sizes, channels=self.channels, unit=True)
        dtype = compute_dtype(self.project.weight)
        flat = pixels.reshape(-1, *pixels.shape[-3:])
        if tuple(flat.shape[1:3]) == self.image_size:
            planes = box_downsample(flat, dtype)
        else:
            planes = pixels_to_planes(flat, dtype)
        if self.training or torch.is_grad_enabled():
            planes = self.convolutions(planes)
        else:
            for convolution in self._folds.get(self._fold, self.convolutions):
                planes = convolution(planes)
        # Flattened in memory order (height, width, channels): no copy.
        embedding: Tensor = self.project(planes.permute(0, 2, 3, 1).flatten(1))
        return embedding.reshape(*pixels.shape[:-3], self.embedding_dim)

    def _fold(self) -> list[FoldedConvolution]:
        """The convolutions with the normalisation after them."""
        layers = list(self.convolutions)
        plain = [one for one in layers if isinstance(one, nn.Conv2d)]
        norms = [one for one in layers if isinstance(one, nn.BatchNorm2d)]
        pairs = zip_longest(plain, norms)
        return [FoldedConvolution(*pair) for pair in pairs]


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions, of which the first has the stride, with a shortcut."""

    def __init__(self, in_channels: int, out_channels: int, *, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(
            in_channels, out_channels, 3, stride=stride, padding=1, bias=False
        )
        self.norm1 = nn.BatchNorm2d(out_channels)
        self.conv2 = nn.Conv2d(out_channels, out_channels, 3, padding=1, bias=False)
        self.norm2 = nn.BatchNorm2d(out_channels)
        self.shortcut: nn.Module = nn.Identity()
        if stride != 1 or in_channels != out_channels:
            self.shortcut = nn.Sequential(
                nn.Conv2d(in_channels, out_channels, 1, stride=stride, bias=False),
                nn.BatchNorm2d(out_channels),
            )
        self._folds = FoldCache()

    def forward(self, planes: Tensor) -> Tensor:
        if not (self.training or torch.is_grad_enabled()):
            first, second, *shortcut = self._folds.get(self._fold, self)
            added = shortcut[0](planes, relu=False) if shortcut else planes
            return second(first(planes), added=added)
        hidden = F.relu(self.norm1(self.conv1(planes)), inplace=True)
        hidden = self.norm2(self.conv2(hidden))
        hidden += self.shortcut(planes)
        return F.relu(hidden, inplace=True)

    def _fold(self) -> list[FoldedConvolution]:
        pairs: list[Any] = [(self.conv1, self.norm1), (self.conv2, self.norm2)]
        if isinstance(self.shortcut, nn.Sequential):
            pairs.append(self.shortcut)
        return [FoldedConvolution(*pair, pack=True) for pair in pairs]


class ResNet18(nn.Module):
    """Embed views with a residual network of 18 layers, trained from scratch.

    Give the views of one update in one call, and call ``eval()`` before embeddings are
    compared with older ones. An ``embedding_dim`` other than 512 adds a linear layer.
    Views are as `SmallEncoder` takes them, by ``channels``.

    Reference:
        He et al., "Deep Residual Learning for Image Recognition" (2015); the paper's
        phi_E and phi_F, eqs. 5 and 13.
    """

    def __init__(
        self,
        embedding_dim: int = 512,
        *,
        image_size: tuple[int, int],
        channels: ChannelOrder = "HWC",
    ) -> None:
        super().__init__()
        self.channels = check_order(channels)
        self.embedding_dim = embedding_dim
        self.image_size = image_size
        self.stem = nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False)
        self.stem_norm = nn.BatchNorm2d(64)
        blocks, width = [], 64
        for out_channels in (64, 128, 256, 512):
            stride = 1 if out_channels == width else 2
            blocks.append(ResidualBlock(width, out_channels, stride=stride))
            blocks.append(ResidualBlock(out_channels, out_channels, stride=1))
            width = out_channels
        self.blocks = nn.Sequential(*blocks)
        self.project: nn.Module = nn.Identity()
        if embedding_dim != width:
            self.project = nn.Linear(width, embedding_dim)
        self._folds = FoldCache()
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, mode="fan_out")
                use_channels_last(layer)

    def forward(self, pixels: Tensor) -> Tensor:
        size, order = self.image_size, self.channels
        pixels = check_pixels(pixels, size, channels=order, unit=True)
        dtype = compute_dtype(self.stem.weight)
        planes = pixels_to_planes(pixels.reshape(-1, *pixels.shape[-3:]), dtype)
        if self.training or torch.is_grad_enabled():
            hidden = F.relu(self.stem_norm(self.stem(planes)), inplace=True)
        else:
            (stem,) = self._folds.get(self._fold, self.stem, self.stem_norm)
            hidden = stem(planes)
        hidden = F.max_pool2d(hidden, 3, stride=2, padding=1)
        hidden = self.blocks(hidden).mean(dim=(2, 3))
        embedding: Tensor = self.project(hidden)
        return embedding.reshape(*pixels.shape[:-3], self.embedding_dim)

    def _fold(self) -> list[FoldedConvolution]:
        return [FoldedConvolution(self.stem, self.stem_norm, pack=True)]
