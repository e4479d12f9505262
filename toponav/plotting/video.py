"""Videos of a trajectory: the first-person view beside a moving arrow on the plan."""

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Transform
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from toponav.plotting.plan import AGENT, VALUE_COLOURS, FloorPlan
from toponav.plotting.style import INK
from toponav.runs import replacing

Frame = NDArray[np.uint8]

# The plan is drawn this much larger and then reduced: that smooths what Pillow draws.
_SUPERSAMPLING = 2
_DPI = 100


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

    Args:
        plan: of the maze.
        positions: ``[T, 2]`` in map units.
        headings: ``[T]`` in degrees.
        height: of the pictures in pixels; their width follows from the plan.
        values: ``[T]``, dark 0 to light 1, the trail's colours; a step has that of the
            decision where it ends. The time by default.
        dots: colours of dots that stay where the agent was, by decision.
        every: yield the first picture and then each ``every``-th.

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
        raise ValueError(
            f"height must be at least 64 and every at least 1, got {height} and {every}"
        )
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
    pictures, uint8 ``[height, *, 3]``; ``gap`` white pixels stand between neighbours.

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
    first, *others = map(Image.fromarray, frames)
    time = round(1000 / fps)
    more: dict[str, Any] = {"append_images": others, "duration": time, "loop": 0}
    first.save(path, save_all=True, optimize=False, **more)
