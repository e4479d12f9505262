"""`PixelTrunk` and `EmbeddingTrunk`: from what the policy sees to its code."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from toponav.modules.pixels import check_pixels, compute_dtype


def start_orthogonal(layer: nn.Linear | nn.Conv2d, gain: float = math.sqrt(2)) -> None:
    """Give a layer orthogonal weights and no bias.

    Args:
        layer: with a weight and a bias.
        gain: scale of the weights; the square root of 2 suits a ReLU after the layer.
    """
    nn.init.orthogonal_(layer.weight, gain)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)


class PixelTrunk(nn.Module):
    """Encode small views with two convolutions and a linear layer.

    16 channels of 8x8 with stride 4, 32 of 4x4 with stride 2, then ``code_dim``, a ReLU
    after each. uint8 images become floats in one pass: the scale of 1/255 is applied to
    the first layer's weights, which are thousands of numbers instead of millions, and
    the images' height, width, RGB layout is torch's ``channels_last`` order.

    Reference:
        Mnih et al., "Asynchronous Methods for Deep Reinforcement Learning" (2016);
        the paper, "Learning model", with its 16 and 32 features.

    Args:
        code_dim: length C of the code.
        image_size: height and width in pixels, both at least 20.

    Raises:
        ValueError: if ``image_size`` is too small; from ``forward``, if the pixels have
            another size or dtype, or are floats that are not finite.

    Examples:
        >>> trunk = PixelTrunk(code_dim=256)
        >>> trunk(torch.zeros(2, 5, 84, 84, 3, dtype=torch.uint8)).shape
        torch.Size([2, 5, 256])

    Shape notation:
        B: any batch dimensions.  C: code.
    """

    def __init__(
        self, code_dim: int = 256, *, image_size: tuple[int, int] = (84, 84)
    ) -> None:
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
        for layer in (self.conv1, self.conv2):
            layer.weight.data = layer.weight.data.contiguous(
                memory_format=torch.channels_last
            )

    def forward(self, pixels: Tensor) -> Tensor:
        """Encode views: ``[*B, H, W, 3]``, uint8 or float in [0, 1], to ``[*B, C]``."""
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
    """Encode a ready embedding of the view with one linear layer and a ReLU.

    The embedding comes from a network that something else trains, such as the
    TC-network; no gradient goes back into it.

    Args:
        embedding_dim: length D of the embedding.
        code_dim: length C of the code.

    Raises:
        ValueError: from ``forward``, if the embedding has another length.

    Examples:
        >>> EmbeddingTrunk(64, code_dim=256)(torch.zeros(2, 5, 64)).shape
        torch.Size([2, 5, 256])

    Shape notation:
        B: any batch dimensions.  D: embedding.  C: code.
    """

    def __init__(self, embedding_dim: int, code_dim: int = 256) -> None:
        super().__init__()
        self.embedding_dim = embedding_dim
        self.code_dim = code_dim
        self.project = nn.Linear(embedding_dim, code_dim)
        start_orthogonal(self.project)

    def forward(self, embedding: Tensor) -> Tensor:
        """Encode embeddings: ``[*B, D]`` to ``[*B, C]``."""
        if embedding.shape[-1] != self.embedding_dim:
            raise ValueError(
                f"embedding must have the length {self.embedding_dim}, got "
                f"{list(embedding.shape)}."
            )
        dtype = self.project.weight.dtype
        return F.relu_(self.project(embedding.detach().to(dtype)))
