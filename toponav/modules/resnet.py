"""`ResNet18`: the paper's encoder, one view to 512 numbers."""

from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from toponav.modules.pixels import (
    check_pixels,
    compute_dtype,
    pixels_to_planes,
    use_channels_last,
)


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

    def forward(self, planes: Tensor) -> Tensor:
        hidden = F.relu(self.norm1(self.conv1(planes)), inplace=True)
        hidden = self.norm2(self.conv2(hidden))
        hidden += self.shortcut(planes)
        return F.relu(hidden, inplace=True)


class ResNet18(nn.Module):
    """Embed views with a residual network of 18 layers, trained from scratch.

    Give the views of one update in one call, and call ``eval()`` before embeddings are
    compared with older ones. torchvision has no build for every torch that we support.

    Reference:
        He et al., "Deep Residual Learning for Image Recognition" (2015); the paper's
        phi_E and phi_F, eqs. 5 and 13.

    Args:
        embedding_dim: length D of the embedding; other than 512 adds a linear layer.
        image_size: height and width in pixels.
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
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, mode="fan_out")
                use_channels_last(layer)

    def forward(self, pixels: Tensor) -> Tensor:
        check_pixels(pixels, self.image_size)
        dtype = compute_dtype(self.stem.weight)
        planes = pixels_to_planes(pixels.reshape(-1, *pixels.shape[-3:]), dtype)
        hidden = F.relu(self.stem_norm(self.stem(planes)), inplace=True)
        hidden = F.max_pool2d(hidden, 3, stride=2, padding=1)
        hidden = self.blocks(hidden).mean(dim=(2, 3))
        embedding: Tensor = self.project(hidden)
        return embedding.reshape(*pixels.shape[:-3], self.embedding_dim)
