"""Exact depth pictures, cast from the pose and the layout.

The engine's own depth picture has 8 bits, saturates at four cells and treats
sky and sprites as it likes. A maze is simple enough to do better: walls are a
grid, floor and wall tops are planes.
"""

import numpy as np
from numpy.typing import NDArray

from toponav.envs.layout import CELL_SIZE, Layout

#: Height of the eye and of the walls above the floor, in map units.
EYE_HEIGHT = 48.0
WALL_HEIGHT = 128.0
# Tangent of half the field of view: 90 degrees across; down, 60 pixels at a focal
# length of 96 (the engine's pixels are 1.2 times as high as wide).
_TAN_ACROSS = 1.0
_TAN_DOWN = 60.0 / 96.0


class DepthCaster:
    r"""Casts depth pictures of one maze for a batch of poses.

    Depth is *planar*: the distance along the viewing direction, not along the
    ray. Apples and the goal are not in it. Where a ray meets the sky, depth is
    ``far``.

    Args:
        layout: the maze.
        size: height and width of the picture; 120 x 160 has one value for every
            pixel of the view, fewer are samples at the centres of larger pixels.

    Raises:
        ValueError: if a side is less than 1.

    Examples:
        >>> caster = DepthCaster(Layout("*****\n*   *\n*****"), (3, 5))
        >>> depth = caster.cast(
        ...     x=np.array([192.0]), y=np.array([192.0]), heading=np.array([0.0])
        ... )
        >>> depth[0, 1, 2]  # two and a half cells to the end of the corridor
        np.float32(320.0)

    Shape notation:
        E: poses.  H, W: height and width.  S: slots.
    """

    def __init__(self, layout: Layout, size: tuple[int, int]) -> None:
        height, width = size
        if min(size) < 1:
            raise ValueError(f"depth must have sides of at least 1, got {size}")
        self.size = size
        rows, columns = layout.shape
        #: Depth of the sky: no two points of the maze are farther apart.
        self.far = float(np.hypot(rows, columns) * CELL_SIZE)
        self._walls = ~layout.open_mask
        self._slots = np.array(list(layout.slots.values()), dtype=np.int64)
        self._across = _pixel_centres(width) * _TAN_ACROSS
        down = _pixel_centres(height) * _TAN_DOWN
        with np.errstate(divide="ignore"):
            self._floor = np.where(down > 0, EYE_HEIGHT / down, np.inf)
            over = (WALL_HEIGHT - EYE_HEIGHT) / -down
        self._highest = np.where(down < 0, over, np.inf)

    def cast(
        self,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        heading: NDArray[np.float64],
        closed: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """Depth pictures in map units.

        Args:
            x: positions ``[E]``, map units.
            y: positions ``[E]``, map units.
            heading: degrees counter-clockwise from east ``[E]``.
            closed: which slots are closed, bool ``[E, S]``; none by default.

        Returns:
            float32 ``[E, H, W]``.
        """
        walls = np.broadcast_to(self._walls, (len(x), *self._walls.shape))
        if closed is not None and closed.any():
            walls = walls.copy()
            row, slot = np.nonzero(closed)
            walls[row, self._slots[slot, 0], self._slots[slot, 1]] = True
        wall = self._cast_walls(walls, x, y, np.deg2rad(heading))
        wall = wall[:, None, :]
        depth = np.minimum(wall, self._floor[None, :, None])
        return np.where(wall > self._highest[None, :, None], self.far, depth).astype(
            np.float32
        )

    def _cast_walls(
        self,
        walls: NDArray[np.bool_],
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        angle: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Planar distance to the first wall in each column, ``[E, W]``.

        Every ray walks from cell border to cell border (Amanatides and Woo,
        1987); lengths along it are in units of planar depth.
        """
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        # Rows grow to the south, so the second axis is measured from the north.
        across = self._across
        steps = np.stack([-(sin - across * cos), cos + across * sin]) / CELL_SIZE
        place = np.stack([walls.shape[1] - y / CELL_SIZE, x / CELL_SIZE])[:, :, None]
        place = np.broadcast_to(place, steps.shape)
        cell = np.floor(place).astype(np.int64)
        sign = np.where(steps < 0, -1, 1)
        with np.errstate(divide="ignore"):
            pace = 1.0 / np.abs(steps)
        border = np.where(steps < 0, place - cell, cell + 1 - place) * pace
        env = np.broadcast_to(np.arange(len(x))[:, None], cell.shape[1:])
        distance = np.zeros(cell.shape[1:])
        flying = np.ones(cell.shape[1:], dtype=bool)
        while flying.any():
            axis = np.argmin(border, axis=0)[None]
            nearest = np.take_along_axis(border, axis, 0)[0]
            distance = np.where(flying, nearest, distance)
            moved = np.take_along_axis(cell, axis, 0) + np.take_along_axis(
                sign, axis, 0
            )
            np.put_along_axis(cell, axis, moved, 0)
            on = nearest + np.take_along_axis(pace, axis, 0)[0]
            np.put_along_axis(border, axis, on[None], 0)
            flying &= ~walls[
                env,
                np.clip(cell[0], 0, walls.shape[1] - 1),
                np.clip(cell[1], 0, walls.shape[2] - 1),
            ]
        return distance


def _pixel_centres(count: int) -> NDArray[np.float64]:
    """Centres of pixels on the interval from -1 to 1."""
    return (np.arange(count) + 0.5) / count * 2.0 - 1.0
