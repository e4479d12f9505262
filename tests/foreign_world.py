"""A small world that is none of ours: rooms on a grid, seen from above as pixels.

Importing this module registers ``ForeignWorld-v0``, so that
``gymnasium.make("tests.foreign_world:ForeignWorld-v0")`` works. It has four actions,
views of 48 x 64 pixels, no rewards and no ground truth.
"""

import colorsys
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

View = NDArray[np.uint8]

# Four rooms with doors between them.
_ROOMS = (
    "#############",
    "#     #     #",
    "#     #     #",
    "#           #",
    "#     #     #",
    "### ##### ###",
    "#     #     #",
    "#     #     #",
    "#           #",
    "#     #     #",
    "#############",
)
_OPEN = np.array([[letter == " " for letter in row] for row in _ROOMS])
_CELLS = np.argwhere(_OPEN)
#: The agent sees so many rows and columns around itself, each tile so many pixels wide.
_SIGHT_ROWS, _SIGHT_COLUMNS, _TILE = 3, 4, 8
_STEPS = {"north": (-1, 0), "south": (1, 0), "west": (0, -1), "east": (0, 1)}


class ForeignWorld(gymnasium.Env[View, np.int64]):
    """A walker on a grid; every tile has a colour and pattern of its own."""

    observation_space = spaces.Box(0, 255, (48, 64, 3), np.uint8)
    action_space = spaces.Discrete(4)

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self._picture = _draw_map()
        self._cell = _CELLS[0]

    def get_action_meanings(self) -> list[str]:
        return list(_STEPS)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[View, dict[str, Any]]:
        super().reset(seed=seed)
        self._cell = _CELLS[self.np_random.integers(len(_CELLS))]
        return self._view(), {}

    def step(self, action: np.int64) -> tuple[View, float, bool, bool, dict[str, Any]]:
        ahead = self._cell + list(_STEPS.values())[int(action)]
        if _OPEN[tuple(ahead)]:
            self._cell = ahead
        return self._view(), 0.0, False, False, {}

    def _view(self) -> View:
        # The map has a margin of as many tiles as the agent sees.
        top, left = self._cell * _TILE + _TILE // 2
        return self._picture[top : top + 48, left : left + 64].copy()


def _draw_map() -> View:
    """The whole world with a black margin; each tile's colours say where it is."""
    rng = np.random.default_rng(0)
    rows, columns = _OPEN.shape
    picture = np.zeros((rows * _TILE, columns * _TILE, 3), dtype=np.uint8)
    for row, column in np.ndindex(rows, columns):
        tile = picture[row * _TILE : (row + 1) * _TILE]
        tile = tile[:, column * _TILE : (column + 1) * _TILE]
        room = 0.5 * (row > 5) + 0.25 * (column > 6)
        if _OPEN[row, column]:
            tile[:] = _colour(room + rng.uniform(-0.08, 0.08), 0.5, rng.uniform(0.5, 1))
            top, left = rng.integers(0, 4, size=2)
            tile[top : top + 4, left : left + 4] = _colour(rng.uniform(), 1.0, 1.0)
        else:
            tile[:] = _colour(room, 0.2, rng.uniform(0.2, 0.4))
    return np.pad(
        picture,
        ((_SIGHT_ROWS * _TILE,) * 2, (_SIGHT_COLUMNS * _TILE,) * 2, (0, 0)),
    )


def _colour(hue: float, saturation: float, value: float) -> View:
    rgb = colorsys.hsv_to_rgb(hue % 1.0, saturation, value)
    return np.round(255 * np.array(rgb)).astype(np.uint8)


gymnasium.register(id="ForeignWorld-v0", entry_point="tests.foreign_world:ForeignWorld")
