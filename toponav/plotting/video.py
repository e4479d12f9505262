"""Videos of a trajectory: the first-person view beside a moving arrow on the plan."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from toponav.plotting.plan import AGENT, VALUE_COLOURS, FloorPlan
from toponav.plotting.style import INK
from toponav.runs import replacing

Frame = NDArray[np.uint8]

# The plan is drawn this much larger and then reduced, which smooths the edges
# of what Pillow draws.
_SUPERSAMPLING = 2
_DPI = 100


class PlanRenderer:
    """Shows an agent and its trail on a plan that is drawn only once.

    Args:
        plan: of the maze.
        height: of the pictures in pixels; their width follows from the plan.

    Examples:
        >>> plan = FloorPlan(np.ones((4, 6)), cell_size=10.0)
        >>> renderer = PlanRenderer(plan, height=120)
        >>> pictures = list(renderer.render([[5, 5], [7, 5]], [0.0, 0.0]))
        >>> pictures[0].shape[0]
        120
    """

    def __init__(self, plan: FloorPlan, *, height: int = 480) -> None:
        if height < 64:
            raise ValueError(f"height must be at least 64, got {height}")
        shape = min(max(plan.size[0] / plan.size[1], 0.5), 2.0)
        width = 2 * round(height * shape / 2)
        inches = (width / _DPI, height / _DPI)
        figure = Figure(figsize=inches, dpi=_DPI * _SUPERSAMPLING)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.02, 0.02, 0.96, 0.96))
        plan.draw(axes)
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
        canvas.draw()
        self._jump = plan.jump
        self._to_pixels = axes.transData
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]
        self._background = Image.fromarray(np.ascontiguousarray(pixels))

    def render(
        self,
        positions: ArrayLike,
        headings: ArrayLike,
        *,
        values: ArrayLike | None = None,
        dots: Mapping[int, str] | None = None,
        every: int = 1,
    ) -> Iterator[Frame]:
        """Yield one picture per decision of a trajectory.

        Args:
            positions: ``[T, 2]`` in map units.
            headings: ``[T]`` in degrees.
            values: ``[T]``, dark 0 to light 1, the trail's colours; a step has that of
                the decision where it ends. The time by default.
            dots: colours of dots that stay where the agent was, by decision.
            every: yield the first picture and then each ``every``-th.

        Yields:
            uint8 ``[height, width, 3]``.
        """
        places = np.asarray(positions, float)
        angles = np.radians(np.asarray(headings, float).reshape(-1))
        shades = np.linspace(0, 1, len(places)) if values is None else values
        shades = np.asarray(shades, float)
        for name, array in (("headings", angles), ("values", shades)):
            if len(array) != len(places):
                raise ValueError(
                    f"{name} must be as many as positions, {len(places)}, "
                    f"got {len(array)}"
                )
        if every < 1:
            raise ValueError(f"every must be at least 1, got {every}")
        pixels = self._to_pixels.transform(places)
        pixels[:, 1] = self._background.height - pixels[:, 1]
        trail = self._background.copy()
        pen = ImageDraw.Draw(trail)
        colours = (VALUE_COLOURS(shades) * 255).astype(int)
        for now, angle in enumerate(angles):
            last = max(now - 1, 0)
            if np.linalg.norm(places[now] - places[last]) <= self._jump:
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


def _draw_disc(
    pen: ImageDraw.ImageDraw, at: np.ndarray, radius: float, colour: str, edge: str
) -> None:
    far = radius * _SUPERSAMPLING
    box = (at[0] - far, at[1] - far, at[0] + far, at[1] + far)
    pen.ellipse(box, fill=colour, outline=edge, width=_SUPERSAMPLING)


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

    Args:
        views: T times uint8 ``[H, W, 3]``, enlarged without smoothing.
        pictures: T times uint8 ``[height, *, 3]`` each, as of `PlanRenderer.render`.
        gap: white pixels between neighbours.

    Yields:
        uint8 ``[height, *, 3]``.

    Examples:
        >>> views, plans = np.zeros((2, 12, 16, 3), np.uint8), np.zeros((2, 24, 24, 3))
        >>> [frame.shape for frame in side_by_side(views, plans, gap=2)]
        [(24, 58, 3), (24, 58, 3)]
    """
    for view, *others in zip(views, *pictures, strict=True):
        height = others[0].shape[0]
        white = np.full((height, gap, 3), 255, np.uint8)
        parts = [enlarge(view, height)]
        for other in others:
            parts += [white, other]
        yield np.concatenate(parts, axis=1)


def write_video(path: str | Path, frames: Iterable[Frame], *, fps: int = 15) -> None:
    """Write frames to ``path`` atomically.

    MP4 is H.264 with yuv420p, which every player shows; an odd last row or
    column is dropped, because that format has none.

    Args:
        path: file to write; its suffix, ``.mp4`` or ``.gif``, decides the format.
        frames: uint8 ``[H, W, 3]`` each, all of one shape; may be a generator.
        fps: frames per second.

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
    with replacing(path) as temporary:
        writers[path.suffix](temporary, _not_empty(frames), fps)


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
