"""The mazes as Gymnasium environments, ``toponav/Maze1-v0`` and so on."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from toponav.envs.doom.engine import HEIGHT, WIDTH
from toponav.envs.doom.fleet import Fleet
from toponav.envs.doom.game import NUM_ACTIONS
from toponav.envs.layout import Layout, load_layout_file
from toponav.envs.mazes import MAZES, load_maze
from toponav.envs.scene import SceneRules

Observation = NDArray[np.uint8]


class MazeEnv(gymnasium.Env[Observation, np.int64]):
    """One maze on one engine, with the episodes of row 0 of ``DoomMazeEnv``.

    ## Description
    A first-person 3-D maze. One step is one *decision*: the action is held for four
    engine tics. Motion does not slip; a cell is 128 map units, 3.9 decisions.

    ## Action Space
    `Discrete(6)`: 0 forward, 1 backward, 2 turn left, 3 turn right, 4 forward and
    left, 5 forward and right. A turn is 20 degrees.

    ## Observation Space
    `Box(0, 255, (120, 160, 3), uint8)`: the view, RGB.

    ## Starting State
    A random cell that is no slot, up to 0.2 cells off its centre, a random heading;
    apples and goal in other cells.

    ## Rewards
    1 for an apple, 10 for the goal, else 0.

    ## Episode End
    Truncation after `episode_length` decisions, or when the engine was lost. The goal
    puts the agent at a new random start and never terminates the episode.

    ## Information
    The truth, for evaluation only: `position` (x east, y north, map units), `heading`
    (degrees counter-clockwise from east), `cell` and `goal_cell` (row and column of the
    layout text, -1 without a goal), `blocked` (which slots are closed), `respawned`.

    ## Arguments
    `maze`: the name of a maze, a `Layout`, or the path of a layout file; the ids set
    it. `apples`, `goal`, `blocked`, `episode_length`, `texture_seed`, `paintings`,
    `marks` as in `DoomMazeEnv`. `render_mode`: `"rgb_array"` or `None`.

    ## Version History
    - v0: first version.

    Examples:
        >>> import toponav.envs
        >>> env = gymnasium.make("toponav/Maze1-v0", apples=5, goal=True)
        >>> view, info = env.reset(seed=0)
        >>> view.shape, info["blocked"]
        ((120, 160, 3), array([False, False]))
        >>> env.close()
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}

    def __init__(
        self,
        maze: str | Layout = "maze1",
        *,
        apples: int = 0,
        goal: bool = False,
        blocked: Sequence[str] = (),
        episode_length: int = 1800,
        texture_seed: int = 0,
        paintings: float = 0.5,
        marks: float = 1.0,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(
                f"render_mode must be 'rgb_array' or None, got {render_mode!r}"
            )
        self.layout = _as_layout(maze)
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
        self.action_space = spaces.Discrete(NUM_ACTIONS)
        self._fleet = Fleet(
            self.layout,
            1,
            rules=SceneRules(apples=apples, goal=goal, blocked=tuple(blocked)),
            episode_length=episode_length,
            texture_seed=texture_seed,
            paintings=paintings,
            marks=marks,
        )
        self._fleet.seed(None)
        self._view: Observation | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is not None:
            self._fleet.seed(seed)
        self._view = self._fleet.reset([0]).pixels[0]
        return self._view, self._truth()

    def step(
        self, action: np.int64
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        snapshot = self._fleet.step([int(action)])
        self._view = snapshot.pixels[0]
        reward, truncated = float(snapshot.reward[0]), bool(snapshot.truncated[0])
        return self._view, reward, False, truncated, self._truth()

    def render(self) -> Observation | None:
        return self._view if self.render_mode == "rgb_array" else None

    def set_slot(self, letter: str, *, closed: bool) -> None:
        """Close or open a slot in mid-episode; takes effect with the next decision.

        Args:
            letter: the slot.
            closed: whether to close or to open it.

        Raises:
            ValueError: if the slot is unknown, or would cut the maze in two.
        """
        self._fleet.set_slot(letter, closed=closed)

    def close(self) -> None:
        self._fleet.close()

    def _truth(self) -> dict[str, Any]:
        x, y, heading = self._fleet.poses()[0]
        return {
            "position": np.array([x, y]),
            "heading": float(heading),
            "cell": self.layout.cell_of(x, y),
            "goal_cell": tuple(self._fleet.goal_cells()[0].tolist()),
            "blocked": self._fleet.closed()[0],
            "respawned": bool(self._fleet.respawned()[0]),
        }


def register_mazes() -> None:
    """Register ``toponav/Maze1-v0``, ``Maze2``, ``Maze3`` and ``Select``."""
    for name in MAZES:
        gymnasium.register(
            id=f"toponav/{name.capitalize()}-v0",
            entry_point="toponav.envs.gym_env:MazeEnv",
            kwargs={"maze": name},
        )


def _as_layout(maze: str | Layout) -> Layout:
    if isinstance(maze, Layout):
        return maze
    if maze.endswith(".txt"):
        return load_layout_file(maze)
    return load_maze(maze)
