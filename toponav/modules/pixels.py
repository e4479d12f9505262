"""`pixels_to_planes`: the environment's images, ready to convolve."""

import torch
from torch import Tensor


def check_pixels(pixels: Tensor, *image_sizes: tuple[int, int]) -> None:
    """Refuse images that an encoder cannot read, in one sentence.

    Only floats are searched for NaN and infinity: the environment yields uint8, so
    the look costs nothing where speed counts.

    Args:
        pixels: ``[*B, H, W, 3]``, uint8 in 0..255 or float in [0, 1].
        image_sizes: each a height and width in pixels that the encoder can read.

    Raises:
        ValueError: on another shape or dtype, or if a float image is not finite.
    """
    if tuple(pixels.shape[-3:]) not in [(*size, 3) for size in image_sizes]:
        expected = " or ".join(str([*size, 3]) for size in image_sizes)
        raise ValueError(
            f"pixels must end in the shape {expected} (height, width, RGB), got "
            f"{list(pixels.shape)}."
        )
    if pixels.dtype == torch.uint8:
        return
    if not pixels.is_floating_point():
        raise ValueError(
            f"pixels must be uint8 in 0..255 or float in [0, 1], got {pixels.dtype}."
        )
    if not torch.compiler.is_compiling() and not bool(pixels.isfinite().all()):
        raise ValueError("pixels must be finite, got NaN or infinity.")


def compute_dtype(weight: Tensor) -> torch.dtype:
    """The dtype in which a layer with this weight will compute: autocast's, or its own.

    Going from uint8 straight to that dtype saves a float32 copy of every image.

    Args:
        weight: the layer's weight.
    """
    device = weight.device.type
    if torch.is_autocast_enabled(device):
        return torch.get_autocast_dtype(device)
    return weight.dtype


def pixels_to_planes(pixels: Tensor, dtype: torch.dtype) -> Tensor:
    """Scale images to [0, 1] and view them as channel planes.

    The environment's height, width, RGB layout *is* torch's ``channels_last`` order,
    so no pixel moves: one conversion, one product, on the device of the pixels.

    Args:
        pixels: ``[N, H, W, 3]``, uint8 in 0..255 or float in [0, 1].
        dtype: the dtype to compute in.

    Returns:
        ``[N, 3, H, W]`` of ``dtype``, in ``channels_last`` memory order.

    Examples:
        >>> image = torch.full((1, 4, 6, 3), 255, dtype=torch.uint8)
        >>> planes = pixels_to_planes(image, torch.float32)
        >>> planes.shape, planes.max().item()
        (torch.Size([1, 3, 4, 6]), 1.0)
        >>> planes.is_contiguous(memory_format=torch.channels_last)
        True
    """
    planes = pixels.permute(0, 3, 1, 2)
    if pixels.dtype == torch.uint8:
        return planes.to(dtype) / 255
    return planes.to(dtype)
