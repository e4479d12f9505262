"""Frames of videos that show an agent, its plan and its numbers."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from toponav.metrics import EpisodeTrace
from toponav.plotting.maps import SPURIOUS, WAYPOINT, reward_limits
from toponav.plotting.plan import VALUE_COLOURS, FloorPlan
from toponav.plotting.style import INK
from toponav.plotting.video import Frame, enlarge, render_plan, side_by_side

_FONT = ImageFont.load_default(12)
_STRIP, _BAR, _GAP = 26, 70, 8
_NOTHING = np.full((3, 4, 3), 160, np.uint8)


def explored_frames(
    trace: EpisodeTrace,
    views: Iterable[ArrayLike],
    *,
    plan: FloorPlan,
    every: int = 12,
    height: int = 300,
) -> Iterator[Frame]:
    """Show an episode: the view, the plan with trail and waypoints, and the numbers.

    The trail has the colour of the intrinsic reward; new waypoints are white dots,
    spurious ones red. Views are uint8 ``[H, W, 3]`` of the first observation and then
    each ``every``-th; ``height`` is that of view and plan in pixels.
    """
    low, high = limits = reward_limits(trace.reward)
    colours = np.where(trace.spurious_waypoint, SPURIOUS, WAYPOINT)
    plans = render_plan(
        plan,
        trace.positions,
        trace.headings,
        height=height,
        values=np.clip((trace.reward - low) / (high - low), 0, 1),
        dots={at: colours[at] for at in np.flatnonzero(trace.is_new_waypoint).tolist()},
        every=every,
    )
    widest = caption(trace, len(trace) - 1, since=-1)
    for number, picture in enumerate(side_by_side(views, plans)):
        at = number * every
        texts = caption(trace, at, since=max(at - every, -1))
        strip = _strip_of_numbers(texts, widest, limits, picture.shape[1])
        yield np.concatenate([picture, strip])


def caption(trace: EpisodeTrace, at: int, *, since: int) -> list[str]:
    """Texts below the frame of observation ``at``; ``since`` is the frame before's."""
    texts = [
        f"decision {at:,} of {len(trace) - 1:,}",
        f"coverage {trace.coverage[at]:.0%}",
        f"reward +{trace.reward[since + 1 : at + 1].sum():.2f}",
        f"return {trace.reward[: at + 1].sum():.1f}",
    ]
    if trace.is_new_waypoint.any():
        new, spurious = trace.is_new_waypoint[: at + 1], trace.spurious_waypoint
        texts.append(f"waypoints {new.sum()} ({spurious[: at + 1].sum()} spurious)")
    return texts


def _strip_of_numbers(
    texts: list[str], widest: list[str], limits: tuple[float, float], width: int
) -> Frame:
    """The texts in columns, and at the right end the colours of the trail."""
    image = Image.new("RGB", (width, _STRIP), "white")
    pen = ImageDraw.Draw(image)
    low, high = f"trail {limits[0]:.2g}", f"{limits[1]:.2g}"
    low_width = pen.textlength(low, _FONT)
    end = width - low_width - pen.textlength(high, _FONT) - _BAR - 2 * _GAP
    # Columns stay where they are while the numbers grow.
    columns = [pen.textlength(text, _FONT) for text in widest]
    space = max((end - _GAP - sum(columns)) / len(columns), 0)
    starts = _GAP + np.cumsum([0, *(column + space for column in columns[:-1])])
    for text, start in zip(texts, starts, strict=True):
        pen.text((start, 4), text, INK, _FONT)
    pen.text((end, 4), low, INK, _FONT)
    bar_start = end + low_width + _GAP // 2
    colours = (VALUE_COLOURS(np.linspace(0, 1, _BAR))[:, :3] * 255).astype(np.uint8)
    bar = Image.fromarray(np.tile(colours, (10, 1, 1)))
    image.paste(bar, (int(bar_start), 8))
    pen.text((bar_start + _BAR + _GAP // 2, 4), high, INK, _FONT)
    return np.asarray(image)


def navigated_frames(
    positions: ArrayLike,
    headings: ArrayLike,
    views: Iterable[ArrayLike],
    targets: Sequence[ArrayLike | None],
    goal: ArrayLike,
    *,
    plan: FloorPlan,
    captions: Sequence[str],
    height: int = 360,
) -> Iterator[Frame]:
    """Show an agent on its path: its view, the target's and the goal's, and the plan.

    Args:
        positions: ``[T, 2]`` in map units.
        headings: ``[T]`` in degrees.
        views: T times uint8 ``[H, W, 3]``.
        targets: T views of where it walks to, ``None`` (grey) while it is lost.
        goal: uint8 ``[h, w, 3]``.
        plan: of the maze.
        captions: T lines of text that stand below.
        height: of the view and the plan in pixels.
    """
    plans = render_plan(plan, positions, headings, height=height)
    small = (height - _GAP) // 2
    goal_panel = _named_panel(goal, small, "goal")
    gap = np.full((height - 2 * small, goal_panel.shape[1], 3), 255, np.uint8)
    panels = (
        np.concatenate([_named_panel(target, small, "walks to"), gap, goal_panel])
        for target in targets
    )
    frames = side_by_side(views, panels, plans, gap=_GAP)
    for frame, text in zip(frames, captions, strict=True):
        strip = Image.new("RGB", (frame.shape[1], _STRIP), "white")
        ImageDraw.Draw(strip).text((_GAP, 4), text, INK, _FONT)
        yield np.concatenate([frame, np.asarray(strip)])


def _named_panel(view: ArrayLike | None, height: int, name: str) -> Frame:
    """A view with its name on it; grey without one."""
    panel = Image.fromarray(enlarge(_NOTHING if view is None else view, height))
    pen = ImageDraw.Draw(panel)
    pen.rectangle((0, 0, pen.textlength(name, _FONT) + 8, 18), fill="white")
    pen.text((4, 1), name, INK, _FONT)
    return np.asarray(panel)
