"""Images as environments yield them, checked, and layers that are ready for them."""

import math

import torch
from torch import Tensor, nn


def check_pixels(pixels: Tensor, *image_sizes: tuple[int, int]) -> None:
    """Raise ValueError unless ``[*B, H, W, 3]``, of such a size, uint8 or float."""
    if tuple(pixels.shape[-3:]) not in [(*size, 3) for size in image_sizes]:
        expected = " or ".join(str([*size, 3]) for size in image_sizes)
        raise ValueError(
            f"pixels must end in the shape {expected} (height, width, RGB), got "
            f"{list(pixels.shape)}."
        )
    # Environments yield uint8: no search for NaN where speed counts.
    if pixels.dtype == torch.uint8:
        return
    if not pixels.is_floating_point():
        raise ValueError(
            f"pixels must be uint8 in 0..255 or float in [0, 1], got {pixels.dtype}."
        )
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
