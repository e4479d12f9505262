"""`navigated_frames`: what an agent sees, where it wants to go, and where it is."""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from toponav.evaluation.plan import INK
from toponav.evaluation.video import Frame, PlanRenderer

_GAP = 8
_FONT_SIZE = 13
_STRIP = 22


def navigated_frames(
    positions: ArrayLike,
    headings: ArrayLike,
    views: Iterable[ArrayLike],
    targets: Sequence[ArrayLike | None],
    goal: ArrayLike,
    *,
    draw: Callable[[Axes], None],
    captions: Sequence[str],
    height: int = 360,
) -> Iterator[Frame]:
    """Show a walk: the view, the target's and the goal's picture, and the plan.

    Args:
        positions: ``[T, 2]`` in map units.
        headings: ``[T]`` in degrees.
        views: T times uint8 ``[H, W, 3]``.
        targets: T pictures, uint8 ``[h, w, 3]``, of what the agent walks to; ``None``
            while it is lost, which is shown as grey.
        goal: uint8 ``[h, w, 3]``.
        draw: draws the plan, such as ``partial(draw_plan, open_mask=mask)``.
        captions: T lines of text that stand below.
        height: of the view and the plan in pixels.

    Yields:
        uint8 frames for `write_video`.

    Raises:
        ValueError: if the numbers of positions, views, targets and captions differ, or
            as `PlanRenderer`.
    """
    plans = PlanRenderer(draw, height=height).walk(positions, headings)
    small = (height - _GAP) // 2
    goal_panel = _panel(goal, small, "goal")
    shown = zip(views, targets, plans, captions, strict=True)
    for view, target, plan, caption in shown:
        images = np.concatenate(
            [_panel(target, small, "walks to"), _white(_GAP, goal_panel), goal_panel]
        )
        images = np.pad(images, ((0, height - len(images)), (0, 0), (0, 0)))
        parts = [_enlarged(view, height), images, plan]
        frame = np.concatenate(_with_gaps(parts, height), axis=1)
        yield np.concatenate([frame, _strip(caption, frame.shape[1])])


def _enlarged(image: ArrayLike, height: int) -> Frame:
    """An image at a height, its pixels left square."""
    pixels = np.asarray(image, np.uint8)
    width = round(pixels.shape[1] * height / pixels.shape[0])
    large = Image.fromarray(pixels).resize((width, height), Image.Resampling.NEAREST)
    return np.asarray(large)


def _panel(image: ArrayLike | None, height: int, name: str) -> Frame:
    """An image with its name on it; grey without one."""
    grey = np.full((3, 4, 3), 160, np.uint8)
    panel = Image.fromarray(_enlarged(grey if image is None else image, height))
    pen = ImageDraw.Draw(panel)
    font = ImageFont.load_default(_FONT_SIZE)
    pen.rectangle((0, 0, pen.textlength(name, font) + 8, 18), fill="white")
    pen.text((4, 1), name, INK, font)
    return np.asarray(panel)


def _white(size: int, like: Frame) -> Frame:
    return np.full((size, like.shape[1], 3), 255, np.uint8)


def _with_gaps(parts: Sequence[Frame], height: int) -> list[Frame]:
    gap = np.full((height, _GAP, 3), 255, np.uint8)
    return [piece for part in parts for piece in (part, gap)][:-1]


def _strip(text: str, width: int) -> Frame:
    image = Image.new("RGB", (width, _STRIP), "white")
    ImageDraw.Draw(image).text((_GAP, 3), text, INK, ImageFont.load_default(_FONT_SIZE))
    return np.asarray(image)
