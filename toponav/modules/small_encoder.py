"""`SmallEncoder`: an encoder for two cores, 66 times cheaper than ResNet-18."""

from collections.abc import Iterator

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torch.nn.utils.fusion import fuse_conv_bn_weights

from toponav.modules.pixels import check_pixels, compute_dtype, pixels_to_planes


def box_downsample(pixels: Tensor, dtype: torch.dtype) -> Tensor:
    """Halve images by the mean over 2x2 pixels, scaled to [0, 1].

    uint8 is added up as int16: exact, and eight times faster than converting first.

    Args:
        pixels: ``[N, H, W, 3]``, uint8 in 0..255 or float in [0, 1].
        dtype: the dtype to compute in afterwards.

    Returns:
        ``[N, 3, H / 2, W / 2]`` of ``dtype``, in ``channels_last`` memory order.

    Examples:
        >>> image = torch.tensor([[0, 0, 102, 102], [0, 255, 102, 102]])
        >>> image = image.to(torch.uint8).reshape(1, 2, 4, 1).expand(1, 2, 4, 3)
        >>> box_downsample(image, torch.float32)[0, 0]
        tensor([[0.2500, 0.4000]])
    """
    num, height, width, channels = pixels.shape
    is_bytes = pixels.dtype == torch.uint8
    rows = pixels.reshape(num, height // 2, 2, width * channels)
    if is_bytes:
        tall = rows[:, :, 0].to(torch.int16) + rows[:, :, 1]
    else:
        tall = rows[:, :, 0] + rows[:, :, 1]
    columns = tall.reshape(num, height // 2, width // 2, 2, channels)
    total = columns[:, :, :, 0] + columns[:, :, :, 1]
    scale = 1 / (4 * 255) if is_bytes else 1 / 4
    return (total.to(dtype) * scale).permute(0, 3, 1, 2)


class SmallEncoder(nn.Module):
    """Embed views with four convolutions on the view halved to 80x60.

    21.7 MFLOP a view (5.8, 8.3, 4.4 and 2.2 in the convolutions, 1.0 in the linear
    layer) against 1430 for ResNet-18. The embedding has no ReLU, so that both signs are
    left to the comparator. Views that were halved before they were stored
    (`AreaDownsample`) are read as they are: the same weights, the same embedding up to
    the rounding of the stored pixels.

    Args:
        embedding_dim: length D of the embedding.
        batch_norm: normalise after every convolution. Then the views of one update
            belong in one call, and ``eval()`` before embeddings are compared with
            older ones.
        image_size: height and width in pixels of a full view, both even.

    Raises:
        ValueError: if ``image_size`` is odd; from ``forward``, if the pixels have
            another size or dtype, or are floats that are not finite.

    Examples:
        >>> encoder = SmallEncoder(embedding_dim=256).eval()
        >>> encoder(torch.zeros(2, 3, 120, 160, 3, dtype=torch.uint8)).shape
        torch.Size([2, 3, 256])
        >>> encoder(torch.zeros(2, 3, 60, 80, 3, dtype=torch.uint8)).shape  # halved
        torch.Size([2, 3, 256])

    Shape notation:
        B: any batch dimensions.  D: embedding.
    """

    def __init__(
        self,
        embedding_dim: int = 256,
        *,
        batch_norm: bool = True,
        image_size: tuple[int, int] = (120, 160),
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
        for out_channels, kernel in ((32, 5), (48, 3), (64, 3), (96, 3)):
            layer = nn.Conv2d(
                channels,
                out_channels,
                kernel,
                stride=2,
                padding=kernel // 2,
                bias=not batch_norm,
            )
            layer.weight.data = layer.weight.data.contiguous(
                memory_format=torch.channels_last
            )
            layers.append(layer)
            if batch_norm:
                layers.append(nn.BatchNorm2d(out_channels))
            layers.append(nn.ReLU(inplace=True))
            channels, height, width = out_channels, (height + 1) // 2, (width + 1) // 2
        self.convolutions = nn.Sequential(*layers)
        self.project = nn.Linear(channels * height * width, embedding_dim)
        # What `_folded` made last, and of what.
        self._folds: list[tuple[Tensor, Tensor | None]] = []
        self._folded_from: list[tuple[int, int]] = []

    def forward(self, pixels: Tensor) -> Tensor:
        """Embed views.

        Args:
            pixels: ``[*B, H, W, 3]`` or halved ``[*B, H / 2, W / 2, 3]``, uint8 in
                0..255 or float in [0, 1].

        Returns:
            ``[*B, D]`` in the dtype that the weights, or autocast, compute in.
        """
        check_pixels(pixels, self.image_size, self.halved_size)
        dtype = compute_dtype(self.project.weight)
        flat = pixels.reshape(-1, *pixels.shape[-3:])
        if tuple(flat.shape[1:3]) == self.image_size:
            planes = box_downsample(flat, dtype)
        else:
            planes = pixels_to_planes(flat, dtype)
        if self.training or torch.is_grad_enabled():
            hidden = self.convolutions(planes)
        else:
            hidden = self._convolve_folded(planes)
        # Flattened in memory order (height, width, channels): no copy.
        embedding: Tensor = self.project(hidden.permute(0, 2, 3, 1).flatten(1))
        return embedding.reshape(*pixels.shape[:-3], self.embedding_dim)

    def _convolve_folded(self, planes: Tensor) -> Tensor:
        """The convolutions, each with the normalisation behind it in its weights.

        That is faster than one after the other.
        """
        convolutions = [one for one in self.convolutions if isinstance(one, nn.Conv2d)]
        folds = self._folded()
        for layer, (weight, bias) in zip(convolutions, folds, strict=True):
            planes = F.conv2d(planes, weight, bias, layer.stride, layer.padding).relu_()
        return planes

    def _folded(self) -> list[tuple[Tensor, Tensor | None]]:
        """Weight and bias of each convolution and the normalisation behind it in one.

        They are made anew when a weight has changed: each change in place counts up the
        version of a tensor, and each exchange gives it other memory. What other
        processes share they can change unseen, so that it is folded each time.
        """
        tensors = [*self.convolutions.parameters(), *self.convolutions.buffers()]
        now = [(tensor.data_ptr(), tensor._version) for tensor in tensors]
        is_shared = any(tensor.is_shared() for tensor in tensors)
        if is_shared or now != self._folded_from:
            self._folds = list(_fold_all(self.convolutions))
            self._folded_from = now
        return self._folds


def _fold_all(layers: nn.Sequential) -> Iterator[tuple[Tensor, Tensor | None]]:
    for at, layer in enumerate(layers):
        if isinstance(layer, nn.Conv2d):
            norm = layers[at + 1]
            if isinstance(norm, nn.BatchNorm2d):
                yield _fold(layer, norm)
            else:
                yield layer.weight, layer.bias


def _fold(layer: nn.Conv2d, norm: nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Weight and bias of a convolution and the normalisation behind it in one."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    return fuse_conv_bn_weights(
        layer.weight,
        layer.bias,
        norm.running_mean,
        norm.running_var,
        norm.eps,
        norm.weight,
        norm.bias,
    )
