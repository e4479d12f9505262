"""The policy's trunks: what it makes of a view or of an embedding."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from toponav.modules.encoders import (
    check_pixels,
    compute_dtype,
    start_orthogonal,
    use_channels_last,
)
from toponav.views import ChannelOrder, check_order


class PixelTrunk(nn.Module):
    """Encode views of 20 pixels or more as ``[*B, C]``: two convolutions, one layer.

    Reference:
        Mnih et al., "Asynchronous Methods for Deep Reinforcement Learning" (2016);
        the paper, "Learning model", with its 16 and 32 features.
    """

    def __init__(
        self,
        code_dim: int = 256,
        *,
        image_size: tuple[int, int],
        channels: ChannelOrder = "HWC",
    ) -> None:
        super().__init__()
        self.channels = check_order(channels)
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
        size, order = self.image_size, self.channels
        pixels = check_pixels(pixels, size, channels=order, unit=True)
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
