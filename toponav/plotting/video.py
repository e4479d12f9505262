"""Videos of an agent: its views beside a moving arrow on the plan, and its numbers."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Transform
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from toponav.metrics import EpisodeTrace
from toponav.plotting.plan import AGENT, VALUE_COLOURS, FloorPlan
from toponav.plotting.style import INK
from toponav.plotting.walks import SPURIOUS, WAYPOINT, reward_limits
from toponav.runs import replacing

Frame = NDArray[np.uint8]

# The plan is drawn this much larger and then reduced: that smooths what Pillow draws.
_SUPERSAMPLING = 2
_DPI = 100
_FONT = ImageFont.load_default(12)
_STRIP, _BAR, _GAP = 26, 70, 8


def render_plan(
    plan: FloorPlan,
    positions: ArrayLike,
    headings: ArrayLike,
    *,
    height: int = 480,
    values: ArrayLike | None = None,
    dots: Mapping[int, str] | None = None,
    every: int = 1,
) -> Iterator[Frame]:
    """Show an agent and its trail on a plan: uint8 ``[height, *, 3]`` per decision.

    Positions ``[T, 2]`` are in map units, headings ``[T]`` in degrees; the width of the
    pictures follows from their ``height`` in pixels. A step of the trail has the colour
    of the ``values`` ``[T]``, dark 0 to light 1, where it ends; they are the time by
    default. ``dots`` are colours, by decision, of dots that stay where the agent was.
    The first picture is yielded and then each ``every``-th.

    Examples:
        >>> plan = FloorPlan(np.ones((4, 6)), cell_size=10.0)
        >>> pictures = render_plan(plan, [[5, 5], [7, 5]], [0.0, 0.0], height=120)
        >>> [picture.shape for picture in pictures]
        [(120, 180, 3), (120, 180, 3)]
    """
    places = np.asarray(positions, float)
    angles = np.radians(np.asarray(headings, float).reshape(-1))
    shades = np.linspace(0, 1, len(places)) if values is None else np.asarray(values)
    if not len(places) == len(angles) == len(shades):
        got = f"{len(places)}, {len(angles)} and {len(shades)}"
        raise ValueError(f"positions, headings, values must be as many, got {got}")
    if height < 64 or every < 1:
        wanted = "height must be at least 64 and every at least 1"
        raise ValueError(f"{wanted}, got {height} and {every}")
    trail, to_pixels = _draw_background(plan, height)
    pixels = to_pixels.transform(places)
    pixels[:, 1] = trail.height - pixels[:, 1]
    pen = ImageDraw.Draw(trail)
    colours = (VALUE_COLOURS(shades.astype(float)) * 255).astype(int)
    for now, angle in enumerate(angles):
        last = max(now - 1, 0)
        if np.linalg.norm(places[now] - places[last]) <= plan.jump:
            ends = [tuple(pixels[last]), tuple(pixels[now])]
            pen.line(ends, tuple(colours[now, :3]), width=3 * _SUPERSAMPLING)
        if now % every:
            continue
        picture = trail.copy()
        brush = ImageDraw.Draw(picture)
        for at, colour in (dots or {}).items():
            if at <= now:
                _draw_disc(brush, pixels[at], 3.5, colour, INK)
        _draw_arrow(brush, pixels[now], angle)
        yield np.asarray(picture.reduce(_SUPERSAMPLING))


def _draw_background(plan: FloorPlan, height: int) -> tuple[Image.Image, Transform]:
    """The plan without an agent, and what maps its units to pixels from below."""
    shape = min(max(plan.size[0] / plan.size[1], 0.5), 2.0)
    inches = (2 * round(height * shape / 2) / _DPI, height / _DPI)
    figure = Figure(figsize=inches, dpi=_DPI * _SUPERSAMPLING)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.96))
    plan.draw(axes)
    axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    return Image.fromarray(np.ascontiguousarray(pixels)), axes.transData


def _draw_disc(
    pen: ImageDraw.ImageDraw, at: np.ndarray, radius: float, colour: str, edge: str
) -> None:
    far = radius * _SUPERSAMPLING
    pen.ellipse([*(at - far), *(at + far)], colour, edge, _SUPERSAMPLING)


def _draw_arrow(pen: ImageDraw.ImageDraw, at: np.ndarray, angle: float) -> None:
    """Draw a disc with an arrow head in it that points along ``angle`` (radians)."""
    _draw_disc(pen, at, 9, AGENT, "white")
    corners = angle + np.array([0.0, 2.4, np.pi, -2.4])
    reach = np.array([0.8, 0.75, 0.25, 0.75]) * 9 * _SUPERSAMPLING
    tips = at + (reach * [np.cos(corners), -np.sin(corners)]).T
    pen.polygon(list(map(tuple, tips)), fill="white")


def enlarge(view: ArrayLike, height: int) -> Frame:
    """A view at a height, its pixels left square."""
    pixels = np.asarray(view, np.uint8)
    size = (round(pixels.shape[1] * height / pixels.shape[0]), height)
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.NEAREST))


def side_by_side(
    views: Iterable[ArrayLike], *pictures: Iterable[Frame], gap: int = 8
) -> Iterator[Frame]:
    """Put each first-person view beside other pictures of the same decision.

    Views, uint8 ``[H, W, 3]``, are enlarged without smoothing to the height of the
    pictures; ``gap`` white pixels stand between neighbours.

    Examples:
        >>> views, plans = np.zeros((2, 12, 16, 3), np.uint8), np.zeros((2, 24, 24, 3))
        >>> [frame.shape for frame in side_by_side(views, plans, gap=2)]
        [(24, 58, 3), (24, 58, 3)]
    """
    for view, *others in zip(views, *pictures, strict=True):
        height = len(others[0])
        white = np.full((height, gap, 3), 255, np.uint8)
        beside = [part for other in others for part in (white, other)]
        yield np.concatenate([enlarge(view, height), *beside], axis=1)


def write_video(path: str | Path, frames: Iterable[Frame], *, fps: int = 15) -> None:
    """Write frames, uint8 ``[H, W, 3]``, to an ``.mp4`` or ``.gif`` file atomically.

    MP4 is H.264 with yuv420p, which every player shows; an odd last row or
    column is dropped, because that format has none.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "grey.gif"
        >>> write_video(path, [np.full((8, 8, 3), 99, np.uint8)] * 3, fps=10)
    """
    path = Path(path)
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    if path.suffix not in writers:
        raise ValueError(f"path must end in .mp4 or .gif, got {path.name!r}")
    if fps < 1:
        raise ValueError(f"fps must be at least 1, got {fps}")
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = map(np.asarray, frames)
    first = next(arrays, None)
    if first is None:
        raise ValueError("frames must have at least one frame, got none")
    with replacing(path) as temporary:
        writers[path.suffix](temporary, chain([first], arrays), fps)


def _write_mp4(path: Path, frames: Iterable[Frame], fps: int) -> None:
    with iio.imopen(path, "w", plugin="pyav") as file:
        file.init_video_stream("libx264", fps=fps, pixel_format="yuv420p")
        for frame in frames:
            height, width = frame.shape[0] // 2 * 2, frame.shape[1] // 2 * 2
            file.write_frame(np.ascontiguousarray(frame[:height, :width]))


def _write_gif(path: Path, frames: Iterable[Frame], fps: int) -> None:
    time = round(1000 / fps)
    iio.imwrite(path, [*frames], plugin="pillow", duration=time, loop=0, optimize=False)


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
    low, high = f"trail {limits[0]:.2g}", f"{limits[1]:.2g}"
    *columns, low_width, high_width = map(_FONT.getlength, [*widest, low, high])
    end = width - low_width - high_width - _BAR - 2 * _GAP
    # Columns stay where they are while the numbers grow.
    space = max((end - _GAP - sum(columns)) / len(columns), 0)
    starts = _GAP + np.cumsum([0, *(column + space for column in columns[:-1])])
    bar, numbers = end + low_width + _GAP // 2, zip(starts, texts, strict=True)
    image = _strip(width, [*numbers, (end, low), (bar + _BAR + _GAP // 2, high)])
    colours = (VALUE_COLOURS(np.linspace(0, 1, _BAR))[:, :3] * 255).astype(np.uint8)
    image.paste(Image.fromarray(np.tile(colours, (10, 1, 1))), (int(bar), 8))
    return np.asarray(image)


def _strip(width: int, texts: Iterable[tuple[float, str]]) -> Image.Image:
    """A white strip with texts, each at its offset in pixels."""
    image = Image.new("RGB", (width, _STRIP), "white")
    for start, text in texts:
        ImageDraw.Draw(image).text((start, 4), text, INK, _FONT)
    return image


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

    ``targets`` are T views of where it walks to, ``None`` (grey) while it is lost, and
    ``captions`` T lines of text that stand below; the others are as for `render_plan`
    and `side_by_side`.
    """
    plans = render_plan(plan, positions, headings, height=height)
    small = (height - _GAP) // 2
    goal_panel = _named_panel(goal, small, "goal")
    nothing = np.full_like(goal, 160, np.uint8)
    gap = np.full((height - 2 * small, goal_panel.shape[1], 3), 255, np.uint8)
    panels = (
        np.concatenate([_named_panel(view, small, "walks to"), gap, goal_panel])
        for view in (nothing if target is None else target for target in targets)
    )
    frames = side_by_side(views, panels, plans, gap=_GAP)
    for frame, text in zip(frames, captions, strict=True):
        strip = np.asarray(_strip(frame.shape[1], [(_GAP, text)]))
        yield np.concatenate([frame, strip])


def _named_panel(view: ArrayLike, height: int, name: str) -> Frame:
    """A view with its name on it."""
    panel = Image.fromarray(enlarge(view, height))
    pen = ImageDraw.Draw(panel)
    pen.rectangle((0, 0, pen.textlength(name, _FONT) + 8, 18), fill="white")
    pen.text((4, 1), name, INK, _FONT)
    return np.asarray(panel)
