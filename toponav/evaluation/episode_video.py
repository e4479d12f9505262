"""`explored_frames`: an episode in first person, on the plan, and in numbers."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from toponav.evaluation.episode_trace import EpisodeTrace
from toponav.evaluation.exploration_map import (
    FALSE_WAYPOINT,
    WAYPOINT,
    reward_limits,
)
from toponav.evaluation.plan import INK, VALUE_COLOURS
from toponav.evaluation.video import Frame, PlanRenderer, side_by_side

_FONT_SIZE = 13
_STRIP = 26
_BAR = 70
_GAP = 8


def explored_frames(
    trace: EpisodeTrace,
    views: Iterable[ArrayLike],
    *,
    draw: Callable[[Axes], None],
    every: int = 12,
    height: int = 300,
) -> Iterator[Frame]:
    """Show an episode: the view, the plan with trail and waypoints, and the numbers.

    The trail has the colour of the intrinsic reward. A waypoint is a white dot where
    it was born, a false one a red dot. Below stand decision, coverage, the reward
    since the frame before, the return, the waypoints, and the trail's colours.

    Args:
        trace: the episode, T observations.
        views: uint8 ``[H, W, 3]`` of the observations shown: the first, and then each
            ``every``-th, ``ceil(T / every)`` in all.
        draw: draws the plan, such as ``partial(draw_plan, open_mask=mask)``.
        every: decisions from frame to frame.
        height: of view and plan in pixels.

    Yields:
        uint8 frames for `write_video`.

    Raises:
        ValueError: if there are more or fewer views, or as `PlanRenderer`.
    """
    low, high = limits = reward_limits(trace.reward)
    born = np.flatnonzero(trace.born)
    dots = {
        int(at): FALSE_WAYPOINT if trace.false_birth[at] else WAYPOINT for at in born
    }
    plans = PlanRenderer(draw, height=height).walk(
        trace.positions,
        trace.headings,
        values=np.clip((trace.reward - low) / (high - low), 0, 1),
        dots=dots,
        every=every,
    )
    pictures = side_by_side(views, plans)
    widest = caption(trace, len(trace) - 1, since=-1)
    for number, picture in enumerate(pictures):
        at = number * every
        lines = caption(trace, at, since=max(at - every, -1))
        strip = _strip(lines, widest, limits, picture.shape[1])
        yield np.concatenate([picture, strip])


def caption(trace: EpisodeTrace, at: int, *, since: int) -> list[str]:
    """What stands below the frame of an observation.

    Args:
        trace: the episode.
        at: number of the observation.
        since: number of the one in the frame before, -1 without one.
    """
    false = int(trace.false_birth[: at + 1].sum())
    return [
        f"decision {at:,} of {len(trace) - 1:,}",
        f"coverage {trace.coverage[at]:.0%}",
        f"reward +{trace.reward[since + 1 : at + 1].sum():.2f}",
        f"return {trace.reward[: at + 1].sum():.1f}",
        f"waypoints {trace.born[: at + 1].sum()} ({false} false)",
    ]


def _strip(
    texts: list[str], widest: list[str], limits: tuple[float, float], width: int
) -> Frame:
    """The texts in columns, and at the right end the colours of the trail."""
    image = Image.new("RGB", (width, _STRIP), "white")
    pen = ImageDraw.Draw(image)
    font = ImageFont.load_default(_FONT_SIZE)
    low, high = (f"{limit:.2g}" for limit in limits)
    labels = [pen.textlength(text, font) for text in (f"trail {low}", high)]
    x = width - sum(labels) - _BAR - 2 * _GAP
    # Columns stay where they are while the numbers grow.
    columns = [pen.textlength(text, font) for text in widest]
    space = max((x - _GAP - sum(columns)) / len(columns), 0)
    left = float(_GAP)
    for text, column in zip(texts, columns, strict=True):
        pen.text((left, 4), text, INK, font)
        left += column + space
    pen.text((x, 4), f"trail {low}", INK, font)
    x += labels[0] + _GAP // 2
    colours = (VALUE_COLOURS(np.linspace(0, 1, _BAR))[:, :3] * 255).astype(np.uint8)
    bar = np.broadcast_to(colours, (10, _BAR, 3))
    image.paste(Image.fromarray(np.ascontiguousarray(bar)), (int(x), 8))
    pen.text((x + _BAR + _GAP // 2, 4), high, INK, font)
    return np.asarray(image)
