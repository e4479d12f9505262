"""`ChannelOrder`: where the channels of views are, and who refuses the other order."""

from collections.abc import Sequence
from typing import Literal, get_args

from torch import Tensor

#: Views are ``[*B, H, W, C]``, or ``[*B, C, H, W]``, TorchRL's usual layout.
ChannelOrder = Literal["HWC", "CHW"]
_COUNTS = (1, 3, 4)
#: How far interpolation may carry floats beyond [0, 1].
OVERSHOOT = 0.25


def check_order(channels: str) -> ChannelOrder:
    """The order that was given; ValueError if there is no such order."""
    if channels not in (orders := get_args(ChannelOrder)):
        raise ValueError(f"channels must be one of {orders}, got {channels!r}")
    return "HWC" if channels == "HWC" else "CHW"


def check_views(name: object, shape: Sequence[int], channels: ChannelOrder) -> None:
    """Raise ValueError for a shape that is no view's, or one's of the other order.

    Examples:
        >>> check_views("pixels", (2, 3, 60, 80), "CHW")
        >>> check_views("pixels", (2, 3, 60, 80), "HWC")
        Traceback (most recent call last):
        ValueError: pixels must be [*B, H, W, C] with channels='HWC', got
        [2, 3, 60, 80]; channels='CHW' takes them
    """
    if len(shape) < 3:
        raise ValueError(f"{name} must be images, got {list(shape)}")
    here, there = (-1, -3) if channels == "HWC" else (-3, -1)
    # Stacked frames have other counts, but fewer channels than rows or columns.
    is_stack = shape[there] < shape[-2] <= shape[here]
    if shape[here] not in _COUNTS and (shape[there] in _COUNTS or is_stack):
        other = "CHW" if channels == "HWC" else "HWC"
        raise ValueError(
            f"{name} must be [*B, {', '.join(channels)}] with channels={channels!r}, "
            f"got {list(shape)}; channels={other!r} takes them"
        )


def channels_last(views: Tensor, channels: ChannelOrder) -> Tensor:
    """Views in the given order, seen as ``[*B, H, W, C]``: no pixel moves."""
    return views if channels == "HWC" else views.movedim(-3, -1)


def as_given(views: Tensor, channels: ChannelOrder) -> Tensor:
    """Undo `channels_last`."""
    return views if channels == "HWC" else views.movedim(-1, -3)


def view_size(shape: Sequence[int], channels: ChannelOrder) -> tuple[int, int]:
    """Height and width of views of a shape."""
    height, width = shape[-3:-1] if channels == "HWC" else shape[-2:]
    return height, width
