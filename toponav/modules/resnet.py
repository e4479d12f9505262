"""`ResNet18`: the paper's encoder, one view to 512 numbers."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from toponav.modules.pixels import check_pixels, compute_dtype, pixels_to_planes


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions around which the input is carried.

    Args:
        in_channels: channels of the input.
        out_channels: channels of the output.
        stride: of the first convolution; 2 halves height and width.

    Examples:
        >>> ResidualBlock(4, 8, stride=2)(torch.zeros(1, 4, 6, 8)).shape
        torch.Size([1, 8, 3, 4])
    """

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

    def forward(self, planes: Tensor) -> Tensor:
        hidden = F.relu(self.norm1(self.conv1(planes)), inplace=True)
        hidden = self.norm2(self.conv2(hidden))
        hidden += self.shortcut(planes)
        return F.relu(hidden, inplace=True)


class ResNet18(nn.Module):
    """Embed views with a residual network of 18 layers, trained from scratch.

    The classic trunk up to the average pool: 11.18 M parameters and 1.43 GFLOP for a
    view of 160x120. Batch normalisation stays on in training, so give the views of one
    update in one call, and call ``eval()`` before embeddings are compared with older
    ones. Ours, because torchvision has no build for every torch we run on.

    Reference:
        He et al., "Deep Residual Learning for Image Recognition" (2015).
        https://arxiv.org/abs/1512.03385; the paper's phi_E and phi_F, eqs. 5 and 13.

    Args:
        embedding_dim: length D of the embedding. 512 is the trunk's own width;
            another length adds a linear layer.
        image_size: height and width in pixels.

    Raises:
        ValueError: from ``forward``, if the pixels have another size or dtype, or are
            floats that are not finite.

    Examples:
        >>> encoder = ResNet18().eval()
        >>> encoder(torch.zeros(2, 120, 160, 3, dtype=torch.uint8)).shape
        torch.Size([2, 512])

    Shape notation:
        B: any batch dimensions.  D: embedding.
    """

    def __init__(
        self, embedding_dim: int = 512, *, image_size: tuple[int, int] = (120, 160)
    ) -> None:
        super().__init__()
        self.embedding_dim = embedding_dim
        self.image_size = image_size
        self.stem = nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False)
        self.stem_norm = nn.BatchNorm2d(64)
        self.blocks = nn.Sequential(
            ResidualBlock(64, 64, stride=1),
            ResidualBlock(64, 64, stride=1),
            ResidualBlock(64, 128, stride=2),
            ResidualBlock(128, 128, stride=1),
            ResidualBlock(128, 256, stride=2),
            ResidualBlock(256, 256, stride=1),
            ResidualBlock(256, 512, stride=2),
            ResidualBlock(512, 512, stride=1),
        )
        self.project: nn.Module = nn.Identity()
        if embedding_dim != 512:
            self.project = nn.Linear(512, embedding_dim)
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, mode="fan_out")
                layer.weight.data = layer.weight.data.contiguous(
                    memory_format=torch.channels_last
                )

    def forward(self, pixels: Tensor) -> Tensor:
        """Embed views.

        Args:
            pixels: ``[*B, H, W, 3]``, uint8 in 0..255 or float in [0, 1].

        Returns:
            ``[*B, D]`` in the dtype that the weights, or autocast, compute in.
        """
        check_pixels(pixels, self.image_size)
        dtype = compute_dtype(self.stem.weight)
        planes = pixels_to_planes(pixels.reshape(-1, *pixels.shape[-3:]), dtype)
        hidden = F.relu(self.stem_norm(self.stem(planes)), inplace=True)
        hidden = F.max_pool2d(hidden, 3, stride=2, padding=1)
        hidden = self.blocks(hidden).mean(dim=(2, 3))
        embedding: Tensor = self.project(hidden)
        return embedding.reshape(*pixels.shape[:-3], self.embedding_dim)
