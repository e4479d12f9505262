"""Image encoders, the policy's trunks, and `check_pixels`."""

import math
from itertools import zip_longest
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from toponav.modules.folding import FoldCache, FoldedConvolution


def check_pixels(pixels: Tensor, *image_sizes: tuple[int, int]) -> None:
    """Raise ValueError unless ``[*B, H, W, 3]``, of such a size, uint8 or float."""
    if tuple(pixels.shape[-3:]) not in [(*size, 3) for size in image_sizes]:
        expected = " or ".join(str([*size, 3]) for size in image_sizes)
        got = list(pixels.shape)
        raise ValueError(f"pixels must end in the shape {expected} (RGB), got {got}.")
    # Environments yield uint8: no search for NaN where speed counts.
    if pixels.dtype == torch.uint8:
        return
    if not pixels.is_floating_point():
        raise ValueError(f"pixels must be uint8 or float in 0..1, got {pixels.dtype}.")
    if not torch.compiler.is_compiling() and not bool(pixels.isfinite().all()):
        raise ValueError("pixels must be finite, got NaN or infinity.")


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
        batch_norm: bool = True,
    ) -> None:
        super().__init__()
        height, width = image_size
        if height % 2 or width % 2:
            raise ValueError(f"image_size must be even, got {image_size}.")
        self.embedding_dim = embedding_dim
        self.image_size = image_size
        self.halved_size = (height // 2, width // 2)
        layers: list[nn.Module] = []
        channels, height, width = 3, height // 2, width // 2
        for out, size in ((32, 5), (48, 3), (64, 3), (96, 3)):
            convolution = nn.Conv2d(
                channels, out, size, stride=2, padding=size // 2, bias=not batch_norm
            )
            layers.append(use_channels_last(convolution))
            if batch_norm:
                layers.append(nn.BatchNorm2d(out))
            layers.append(nn.ReLU(inplace=True))
            channels, height, width = out, (height + 1) // 2, (width + 1) // 2
        self.convolutions = nn.Sequential(*layers)
        self.project = nn.Linear(channels * height * width, embedding_dim)
        self._folds = FoldCache()

    def forward(self, pixels: Tensor) -> Tensor:
        check_pixels(pixels, self.image_size, self.halved_size)
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

    Reference:
        He et al., "Deep Residual Learning for Image Recognition" (2015); the paper's
        phi_E and phi_F, eqs. 5 and 13.
    """

    def __init__(
        self, embedding_dim: int = 512, *, image_size: tuple[int, int]
    ) -> None:
        super().__init__()
        self.embedding_dim = embedding_dim
        self.image_size = image_size
        self.stem = nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False)
        self.stem_norm = nn.BatchNorm2d(64)
        blocks, channels = [], 64
        for out_channels in (64, 128, 256, 512):
            stride = 1 if out_channels == channels else 2
            blocks.append(ResidualBlock(channels, out_channels, stride=stride))
            blocks.append(ResidualBlock(out_channels, out_channels, stride=1))
            channels = out_channels
        self.blocks = nn.Sequential(*blocks)
        self.project: nn.Module = nn.Identity()
        if embedding_dim != channels:
            self.project = nn.Linear(channels, embedding_dim)
        self._folds = FoldCache()
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, mode="fan_out")
                use_channels_last(layer)

    def forward(self, pixels: Tensor) -> Tensor:
        check_pixels(pixels, self.image_size)
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


class PixelTrunk(nn.Module):
    """Encode views of 20 pixels or more as ``[*B, C]``: two convolutions, one layer.

    Reference:
        Mnih et al., "Asynchronous Methods for Deep Reinforcement Learning" (2016);
        the paper, "Learning model", with its 16 and 32 features.
    """

    def __init__(self, code_dim: int = 256, *, image_size: tuple[int, int]) -> None:
        super().__init__()
        if min(image_size) < 20:
            raise ValueError(
                f"image_size must be at least 20 both ways, got {image_size}."
            )
        self.code_dim = code_dim
        self.image_size = image_size
        self.conv1 = nn.Conv2d(3, 16, 8, stride=4)
        self.conv2 = nn.Conv2d(16, 32, 4, stride=2)
        height, width = (((side - 8) // 4 + 1 - 4) // 2 + 1 for side in image_size)
        self.project = nn.Linear(32 * height * width, code_dim)
        for layer in (self.conv1, self.conv2, self.project):
            start_orthogonal(layer)
        use_channels_last(self.conv1)
        use_channels_last(self.conv2)

    def forward(self, pixels: Tensor) -> Tensor:
        check_pixels(pixels, self.image_size)
        dtype = compute_dtype(self.conv1.weight)
        weight = self.conv1.weight
        if pixels.dtype == torch.uint8:
            weight = weight / 255
        planes = pixels.reshape(-1, *pixels.shape[-3:]).permute(0, 3, 1, 2).to(dtype)
        hidden = F.relu_(F.conv2d(planes, weight, self.conv1.bias, stride=4))
        hidden = F.relu_(self.conv2(hidden))
        # Flattened in memory order (height, width, channels): no copy.
        code = F.relu_(self.project(hidden.permute(0, 2, 3, 1).flatten(1)))
        return code.reshape(*pixels.shape[:-3], self.code_dim)


class EmbeddingTrunk(nn.Module):
    """Encode embeddings ``[*B, D]`` as ``[*B, C]`` with one linear layer and a ReLU."""

    def __init__(self, embedding_dim: int, code_dim: int = 256) -> None:
        super().__init__()
        self.embedding_dim = embedding_dim
        self.project = nn.Linear(embedding_dim, code_dim)
        start_orthogonal(self.project)

    def forward(self, embedding: Tensor) -> Tensor:
        if embedding.shape[-1] != self.embedding_dim:
            lengths = f"{self.embedding_dim}, got {list(embedding.shape)}"
            raise ValueError(f"embedding must have the length {lengths}.")
        dtype = self.project.weight.dtype
        # Another objective trains the network behind the embedding.
        return F.relu_(self.project(embedding.detach().to(dtype)))
