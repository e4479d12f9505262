"""Videos of a walk: the first-person view beside a moving arrow on the plan.

- :class:`PlanRenderer`: one picture of the plan per decision, fast.
- :func:`side_by_side`: view and plan in one frame.
- :func:`write_video`: frames to an MP4 or GIF file.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from toponav.evaluation.plan import AGENT, INK, VALUE_COLOURS

Frame = NDArray[np.uint8]

# The plan is drawn this much larger and then reduced, which smooths the edges
# of what Pillow draws.
_SUPERSAMPLING = 2
_DPI = 100


class PlanRenderer:
    """Shows an agent and its trail on a plan that is drawn only once.

    Matplotlib takes about 0.1 s for a plan; pasting a trail and an arrow head on
    the finished picture takes milliseconds.

    Args:
        draw: draws the plan, such as ``partial(draw_plan, open_mask=mask)``.
        height: of the pictures in pixels; their width follows from the plan.

    Raises:
        ValueError: if ``height`` is below 64.

    Examples:
        >>> import torch
        >>> from functools import partial
        >>> from toponav.evaluation.plan import draw_plan
        >>> mask = torch.ones(4, 6, dtype=torch.bool)
        >>> renderer = PlanRenderer(partial(draw_plan, open_mask=mask), height=120)
        >>> pictures = list(renderer.walk([[64, 64], [90, 64]], [0.0, 0.0]))
        >>> pictures[0].shape[0]
        120
    """

    def __init__(self, draw: Callable[[Axes], None], *, height: int = 480) -> None:
        if height < 64:
            raise ValueError(f"height must be at least 64, got {height}")
        probe = Figure().subplots()
        draw(probe)
        wide, tall = np.ptp(probe.get_xlim()), np.ptp(probe.get_ylim())
        width = 2 * round(height * min(max(wide / tall, 0.5), 2.0) / 2)
        inches = (width / _DPI, height / _DPI)
        figure = Figure(figsize=inches, dpi=_DPI * _SUPERSAMPLING)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.02, 0.02, 0.96, 0.96))
        draw(axes)
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
        canvas.draw()
        self._to_pixels = axes.transData
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]
        self._background = Image.fromarray(np.ascontiguousarray(pixels))

    def walk(
        self,
        positions: ArrayLike,
        headings: ArrayLike,
        *,
        jump: float = 256.0,
        values: ArrayLike | None = None,
        dots: Mapping[int, str] | None = None,
        every: int = 1,
    ) -> Iterator[Frame]:
        """Yield one picture per decision of a walk.

        Args:
            positions: ``[T, 2]`` in map units.
            headings: ``[T]`` in degrees.
            jump: a step longer than this many map units leaves no trail.
            values: ``[T]``, dark 0 to light 1, the trail's colours; a step has that of
                the decision where it ends. The time by default.
            dots: colours of dots that stay where the agent was, by decision.
            every: yield the first picture and then each ``every``-th.

        Yields:
            uint8 ``[height, width, 3]``.

        Raises:
            ValueError: if the numbers of positions, headings and values differ or
                ``every < 1``.
        """
        places = np.asarray(positions, float)
        angles = np.radians(np.asarray(headings, float).reshape(-1))
        if len(places) != len(angles):
            raise ValueError(
                f"headings must be as many as positions, {len(places)}, "
                f"got {len(angles)}"
            )
        if every < 1:
            raise ValueError(f"every must be at least 1, got {every}")
        shades = (
            np.linspace(0, 1, len(places)) if values is None else np.asarray(values)
        )
        if len(shades) != len(places):
            raise ValueError(
                f"values must be as many as positions, {len(places)}, got {len(shades)}"
            )
        pixels = self._to_pixels.transform(places)
        pixels[:, 1] = self._background.height - pixels[:, 1]
        trail = self._background.copy()
        pen = ImageDraw.Draw(trail)
        colours = (VALUE_COLOURS(shades) * 255).astype(int)
        for now, angle in enumerate(angles):
            last = max(now - 1, 0)
            if np.linalg.norm(places[now] - places[last]) <= jump:
                ends = [tuple(pixels[last]), tuple(pixels[now])]
                pen.line(ends, tuple(colours[now, :3]), width=3 * _SUPERSAMPLING)
            if now % every:
                continue
            picture = trail.copy()
            brush = ImageDraw.Draw(picture)
            for at, colour in (dots or {}).items():
                if at <= now:
                    _draw_dot(brush, pixels[at], colour)
            _draw_arrow(brush, pixels[now], angle)
            yield np.asarray(picture.reduce(_SUPERSAMPLING))


def _draw_dot(pen: ImageDraw.ImageDraw, at: np.ndarray, colour: str) -> None:
    x, y = at
    radius = 3.5 * _SUPERSAMPLING
    box = (x - radius, y - radius, x + radius, y + radius)
    pen.ellipse(box, fill=colour, outline=INK, width=_SUPERSAMPLING)


def _draw_arrow(pen: ImageDraw.ImageDraw, at: np.ndarray, angle: float) -> None:
    """Draw a disc with an arrow head in it that points along ``angle`` (radians)."""
    radius = 9 * _SUPERSAMPLING
    x, y = at
    box = (x - radius, y - radius, x + radius, y + radius)
    pen.ellipse(box, fill=AGENT, outline="white", width=_SUPERSAMPLING)
    corners = np.array([0.0, 2.4, np.pi, -2.4])
    reach = np.array([0.8, 0.75, 0.25, 0.75]) * radius
    tips = [
        (x + far * np.cos(angle + turn), y - far * np.sin(angle + turn))
        for turn, far in zip(corners, reach, strict=True)
    ]
    pen.polygon(tips, fill="white")


def side_by_side(
    views: Iterable[ArrayLike], plans: Iterable[Frame], *, gap: int = 8
) -> Iterator[Frame]:
    """Put each first-person view beside the plan of the same decision.

    A view is enlarged to the plan's height, by a whole factor and without
    smoothing if that fits, so that its pixels stay what the agent saw.

    Args:
        views: T times uint8 ``[H, W, 3]``, such as a ``[T, H, W, 3]`` tensor.
        plans: T times uint8 ``[height, width, 3]``, of :meth:`PlanRenderer.walk`.
        gap: white pixels between the two.

    Yields:
        uint8 ``[height, W * height / H + gap + width, 3]``.

    Raises:
        ValueError: if there are more views than plans or the other way round.

    Examples:
        >>> views, plans = np.zeros((2, 12, 16, 3), np.uint8), np.zeros((2, 24, 24, 3))
        >>> frames = list(side_by_side(views, plans.astype(np.uint8), gap=2))
        >>> len(frames), frames[0].shape
        (2, (24, 58, 3))
    """
    for view, plan in zip(views, plans, strict=True):
        image = np.asarray(view)
        height = plan.shape[0]
        size = (round(image.shape[1] * height / image.shape[0]), height)
        large = Image.fromarray(image).resize(size, Image.Resampling.NEAREST)
        white = np.full((height, gap, 3), 255, np.uint8)
        yield np.concatenate([np.asarray(large), white, plan], axis=1)


def write_video(path: str | Path, frames: Iterable[Frame], *, fps: int = 15) -> None:
    """Write frames to ``path``, which appears only once it is complete.

    MP4 is H.264 with yuv420p, which every player shows; an odd last row or
    column is dropped, because that format has none.

    Args:
        path: file to write; its suffix, ``.mp4`` or ``.gif``, decides the format.
        frames: uint8 ``[H, W, 3]`` each, all of one shape; may be a generator.
        fps: frames per second.

    Raises:
        ValueError: if the suffix is another one, ``fps < 1`` or there is no frame.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "grey.gif"
        >>> write_video(path, [np.full((8, 8, 3), 99, np.uint8)] * 3, fps=10)
        >>> path.exists()
        True
    """
    path = Path(path)
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    if path.suffix not in writers:
        raise ValueError(f"path must end in .mp4 or .gif, got {path.name!r}")
    if fps < 1:
        raise ValueError(f"fps must be at least 1, got {fps}")
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        writers[path.suffix](unfinished, _not_empty(frames), fps)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def _not_empty(frames: Iterable[Frame]) -> Iterator[Frame]:
    empty = True
    for frame in frames:
        empty = False
        yield np.asarray(frame)
    if empty:
        raise ValueError("frames must have at least one frame, got none")


def _write_mp4(path: Path, frames: Iterator[Frame], fps: int) -> None:
    with iio.imopen(path, "w", plugin="pyav") as file:
        file.init_video_stream("libx264", fps=fps, pixel_format="yuv420p")
        for frame in frames:
            height, width = frame.shape[0] // 2 * 2, frame.shape[1] // 2 * 2
            file.write_frame(np.ascontiguousarray(frame[:height, :width]))


def _write_gif(path: Path, frames: Iterator[Frame], fps: int) -> None:
    first, *others = (Image.fromarray(frame) for frame in frames)
    first.save(
        path,
        save_all=True,
        append_images=others,
        duration=round(1000 / fps),
        loop=0,
        optimize=False,
    )
