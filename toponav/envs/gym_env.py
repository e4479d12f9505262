"""The mazes as Gymnasium environments, ``toponav/Maze1-v0`` and so on."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from toponav.envs.layout import Layout, load_layout_file
from toponav.envs.maze_env import MazeEnv
from toponav.envs.mazes import MAZES, load_maze

Observation = NDArray[np.uint8]


class MazeGymEnv(gymnasium.Env[Observation, np.int64]):
    """One maze on one engine, with the episodes of row 0 of ``MazeEnv``.

    ``env.unwrapped.world`` has the numbers. `info` holds the ground truth, for
    evaluation only: what `toponav.keys` describes under ``privileged``.

    ## Arguments
    `maze`: the name of a maze, a `Layout`, or the path of a layout file; the ids set
    it. `render_mode`: `"rgb_array"` or `None`. `**options`: those of `MazeEnv`.

    Examples:
        >>> import toponav.envs
        >>> env = gymnasium.make("toponav/Maze1-v0", apples=5, goal=True)
        >>> view, info = env.reset(seed=0)
        >>> view.shape == (*env.unwrapped.world.view_size, 3), info["blocked"]
        (True, array([False, False]))
        >>> env.close()
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}

    def __init__(
        self,
        maze: str | Path | Layout = "maze1",
        *,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(
                f"render_mode must be 'rgb_array' or None, got {render_mode!r}"
            )
        self.layout = maze if isinstance(maze, Layout) else _load(maze)
        self._env = MazeEnv(self.layout, batch_size=1, **options)
        self._games, self.world = self._env.games, self._env.world
        self.render_mode = render_mode
        view = (*self.world.view_size, 3)
        self.observation_space = spaces.Box(0, 255, view, np.uint8)
        self.action_space = spaces.Discrete(self.world.num_actions)
        self._view: Observation | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is not None:
            self._games.seed(seed)
        self._view = self._games.reset([0]).pixels[0]
        return self._view, self._truth()

    def step(
        self, action: np.int64
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        snapshot = self._games.step([int(action)])
        self._view = snapshot.pixels[0]
        reward, truncated = float(snapshot.reward[0]), bool(snapshot.truncated[0])
        return self._view, reward, False, truncated, self._truth()

    def render(self) -> Observation | None:
        return self._view if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self._env.close(raise_if_closed=False)

    def _truth(self) -> dict[str, Any]:
        truth = {key: entry[0] for key, entry in self._games.truth().items()}
        cells = {key: tuple(truth[key].tolist()) for key in ("cell", "goal_cell")}
        numbers = {key: truth[key].item() for key in ("heading", "respawned")}
        return {**truth, **cells, **numbers}


def _load(maze: str | Path) -> Layout:
    """A maze of the package by its name, or one of a file."""
    path = Path(maze)
    # A word alone is the name of a maze, unless there is a file of that name.
    is_word = path.name == maze and not path.suffix and not path.is_file()
    return load_maze(str(maze)) if maze in MAZES or is_word else load_layout_file(path)


def register_mazes() -> None:
    """Register ``toponav/Maze1-v0``, ``Maze2``, ``Maze3`` and ``Select``."""
    for name in MAZES:
        gymnasium.register(
            id=f"toponav/{name.capitalize()}-v0",
            entry_point="toponav.envs.gym_env:MazeGymEnv",
            kwargs={"maze": name},
        )
