"""Where goals can be, and the pictures by which an agent knows them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torchrl.envs import EnvBase, InitTracker, TransformedEnv
from torchrl.envs.transforms import Compose

from toponav.builders.explore_collector import seed_of
from toponav.builders.mazes import make_env
from toponav.builders.navigation import Explored
from toponav.config import MazeConfig, NavigateConfig, SettingsError
from toponav.evaluation import FrontierExpert, pick_goal_views
from toponav.graph import Navigator
from toponav.keys import HEADING, PIXELS, POSITION, REWARD
from toponav.transforms import GoalViews, PreviousReward

# Apart from the seeds of the episodes, and how long the photographer walks.
_WALK, _WALKERS, _DECISIONS = 55, 4, 900
#: What the task pays for a goal, and for nothing else.
GOAL_REWARD = 10.0


@dataclass
class GoalPlaces:
    """The places where a goal can be.

    Args:
        cells: int64 ``[K, 2]``, row and column.
        views: uint8 ``[K, V, H, W, 3]``, V pictures of each.
    """

    cells: Tensor
    views: Tensor


def make_goal_places(config: NavigateConfig, explored: Explored) -> GoalPlaces:
    """Choose the pictures of every cell that is no slot.

    Whoever poses the task knows where each picture was taken; the agent gets the
    pictures alone.

    Raises:
        SettingsError: if a cell has no picture.
    """
    slots = set(explored.layout.slots.values())
    cells = [cell for cell in explored.layout.cells if cell not in slots]
    if config.goals.source == "map":
        views, poses = explored.map.images, np.asarray(explored.poses)
    else:
        views, poses = _walk_for_views(config, explored)
    chosen = pick_goal_views(
        poses[:, :2],
        poses[:, 2],
        cells,
        explored.ways,
        num_views=config.goals.views,
    )
    if (chosen < 0).any():
        missing = [cells[at] for at in (chosen[:, 0] < 0).nonzero()[0]]
        raise SettingsError(
            f"goals.source must have a picture of every place, got none of "
            f"{len(missing)} cells, the first {missing[0]}, from "
            f"'{config.goals.source}' (did you mean a longer exploration, or "
            "goals.source=walk?)"
        )
    return GoalPlaces(torch.tensor(cells), views[torch.from_numpy(chosen)])


def _walk_for_views(
    config: NavigateConfig, explored: Explored
) -> tuple[Tensor, np.ndarray]:
    """Views and poses of a scripted walk through the whole maze, without a goal."""
    maze = replace(config.maze, goal=False, blocked=[], apples=0)
    env = make_env(
        maze,
        batch_size=_WALKERS,
        seed=seed_of(config.seed, _WALK),
        privileged=True,
    )
    walker = FrontierExpert(
        torch.as_tensor(explored.layout.open_mask),
        slot_cells=list(explored.layout.slots.values()),
        init_key=None,
        seed=config.seed,
    )
    views, poses = [], []
    try:
        now = env.reset()
        for _ in range(_DECISIONS):
            views.append(now[PIXELS])
            poses.append(torch.cat([now[POSITION], now[HEADING]], -1))
            _, now = env.step_and_maybe_reset(walker(now))
    finally:
        env.close()
    return torch.cat(views), np.asarray(torch.cat(poses), float)


def find_lost_goals(
    navigator: Navigator, places: GoalPlaces, cells_only: int = 3
) -> str | None:
    """A sentence about goals whose pictures are like no waypoint, if there are any."""
    views = places.views
    embedding = navigator.embed(views.flatten(0, 1)).float()
    _, similarity = navigator.localiser.nearest(embedding)
    best = similarity.reshape(views.shape[:2]).max(1).values
    unlike = (best <= navigator.localiser.tc_reach).nonzero().flatten().tolist()
    if not unlike:
        return None
    named = ", ".join(
        f"{tuple(places.cells[at].tolist())} ({best[at]:.2f})"
        for at in unlike[:cells_only]
    )
    return (
        "a goal's pictures must be like a waypoint, with a similarity above "
        f"{navigator.localiser.tc_reach:.2f}, got less for {len(unlike)} of "
        f"{len(best)} cells: {named}; the most similar waypoint is taken"
    )


def make_navigation_env(
    maze: MazeConfig, places: GoalPlaces, *, envs: int, seed: int
) -> EnvBase:
    """A batch of mazes with a goal, its pictures, and all that a navigator reads.

    The truth is there too, for those who judge and for the oracle.

    Args:
        maze: with ``goal`` true.
        places: the pictures.
        envs: number of mazes E side by side.
        seed: of the episodes.

    Raises:
        SettingsError: if the settings do not fit the maze.
        EngineError: if the engine cannot start.
    """
    bare = make_env(maze, batch_size=envs, seed=seed, privileged=True)
    return TransformedEnv(
        bare,
        Compose(
            GoalViews(places.cells, places.views),
            PreviousReward(GOAL_REWARD, in_keys=[REWARD]),
            InitTracker(),
        ),
    )


def closed_letters(letters: Sequence[str]) -> str:
    """What is closed, in words.

    Examples:
        >>> closed_letters([]), closed_letters(["a", "b"])
        ('nothing closed', 'a, b closed')
    """
    return f"{', '.join(letters) or 'nothing'} closed"
