"""Exact depth pictures, cast from pose and layout: ViZDoom's have 8 bits only."""

import numpy as np
from numpy.typing import NDArray

from toponav.envs.game import Camera
from toponav.envs.layout import Layout

Floats = NDArray[np.float64]


class DepthCaster:
    r"""Casts depth pictures of one maze for a batch of poses.

    Depth is *planar*: the distance along the viewing direction. Apples and goal are not
    in it. Where a ray meets the sky, depth is ``far``. ``size`` is height H and width W
    of the picture, with samples at its pixels' centres.

    Reference:
        Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", 1987.

    Examples:
        >>> camera = Camera(eye_height=4, wall_height=10, tan_across=1, tan_down=0.75)
        >>> layout = Layout("*****\n*   *\n*****")
        >>> caster = DepthCaster(layout, (3, 5), camera=camera, cell_size=10)
        >>> x = y = np.array([15.0])
        >>> depth = caster.cast(x, y, heading=np.array([0.0]))
        >>> depth[0, 1, 2]  # two and a half cells to the end of the corridor
        np.float32(25.0)
    """

    def __init__(
        self, layout: Layout, size: tuple[int, int], *, camera: Camera, cell_size: float
    ) -> None:
        if min(size) < 1:
            raise ValueError(f"depth must have sides of at least 1, got {size}")
        self.size = size
        #: Depth of the sky: no two points of the maze are farther apart.
        self.far = float(np.hypot(*layout.shape) * cell_size)
        self._cell_size = cell_size
        self._walls = ~layout.open_mask
        self._slots = np.array(list(layout.slots.values()), dtype=np.int64)
        self._across = _pixel_centres(size[1]) * camera.tan_across
        down = _pixel_centres(size[0]) * camera.tan_down
        with np.errstate(divide="ignore"):
            self._floor = np.where(down > 0, camera.eye_height / down, np.inf)
            over = (camera.wall_height - camera.eye_height) / -down
        self._highest = np.where(down < 0, over, np.inf)

    def cast(
        self,
        x: Floats,
        y: Floats,
        heading: Floats,
        closed: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """Depth pictures of poses ``[E]`` in map units, float32 ``[E, H, W]``.

        ``closed`` says which slots are closed, bool ``[E, S]``; none by default.
        """
        walls = np.broadcast_to(self._walls, (len(x), *self._walls.shape))
        if closed is not None and closed.any():
            walls = walls.copy()
            row, slot = np.nonzero(closed)
            walls[row, self._slots[slot, 0], self._slots[slot, 1]] = True
        wall = self._cast_walls(walls, x, y, np.deg2rad(heading))[:, None, :]
        depth = np.minimum(wall, self._floor[None, :, None])
        sky = wall > self._highest[None, :, None]
        return np.where(sky, self.far, depth).astype(np.float32)

    def _cast_walls(
        self, walls: NDArray[np.bool_], x: Floats, y: Floats, angle: Floats
    ) -> Floats:
        """Planar distance to the first wall in each column, ``[E, W]``."""
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        # Rows grow to the south, so the second axis is measured from the north.
        across, unit = self._across, self._cell_size
        steps = np.stack([-(sin - across * cos), cos + across * sin]) / unit
        place = np.stack([walls.shape[1] - y / unit, x / unit])[:, :, None]
        place = np.broadcast_to(place, steps.shape)
        cell = np.floor(place).astype(np.int64)
        sign = np.where(steps < 0, -1, 1)
        with np.errstate(divide="ignore"):
            stride = 1.0 / np.abs(steps)
        border = np.where(steps < 0, place - cell, cell + 1 - place) * stride
        env, ray = np.indices(cell.shape[1:])
        distance = np.zeros(cell.shape[1:])
        flying = np.ones(cell.shape[1:], dtype=bool)
        while flying.any():
            axis = np.argmin(border, axis=0)
            distance = np.where(flying, border[axis, env, ray], distance)
            cell[axis, env, ray] += sign[axis, env, ray]
            border[axis, env, ray] += stride[axis, env, ray]
            # Rays that have met the border wall go on outside, unused.
            rows = np.clip(cell[0], 0, walls.shape[1] - 1)
            columns = np.clip(cell[1], 0, walls.shape[2] - 1)
            flying &= ~walls[env, rows, columns]
        return distance


def _pixel_centres(count: int) -> Floats:
    return (np.arange(count) + 0.5) / count * 2.0 - 1.0
