"""Where goals can be, and the pictures by which an agent knows them."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torchrl.envs import EnvBase, InitTracker, TransformedEnv
from torchrl.envs.transforms import Compose

from toponav.builders.collection import collect_rollout
from toponav.builders.mazes import make_env
from toponav.builders.navigation import AgentKnowledge, GroundTruth
from toponav.builders.processes import seed_of
from toponav.config import NavigateConfig, SettingsError
from toponav.ground_truth import pick_goal_views
from toponav.keys import HEADING, PIXELS, POSITION, REWARD
from toponav.policies import FrontierExpert
from toponav.transforms import GoalViews, PreviousReward

Cell = tuple[int, int]
# Apart from the seeds of the episodes.
_WALK, _WALKERS = 55, 4
# Decisions of a walk between two choices of pictures; most decisions for each cell.
_CHUNK, _MOST_PER_CELL = 900, 50


@dataclass(frozen=True)
class GoalPlaces:
    """The places where a goal can be: those with pictures.

    Args:
        cells: int64 ``[K, 2]``, row and column.
        views: uint8 ``[K, V, H, W, 3]``, V pictures of each.
        num_without: how many other places have no picture.
    """

    cells: Tensor
    views: Tensor
    num_without: int = 0


def make_goal_places(
    config: NavigateConfig, knowledge: AgentKnowledge, truth: GroundTruth
) -> GoalPlaces:
    """Choose pictures of every cell that is no slot and of which there are some.

    Whoever poses the task knows where each picture was taken; the agent gets the
    pictures alone.

    Raises:
        SettingsError: if no cell has a picture.
    """
    slots = set(truth.layout.slots.values())
    cells = [cell for cell in truth.layout.cells if cell not in slots]
    if config.goals.source == "map":
        views, poses = knowledge.map.waypoints.images, np.asarray(truth.poses)
    else:
        views, poses = _walk_for_views(config, truth, cells)
    chosen = _choose(config, truth, cells, poses)
    found = torch.from_numpy((chosen >= 0).all(1))
    if not found.any():
        raise SettingsError(
            f"goals.source must have a picture of one of {len(cells)} places at least, "
            f"got none from '{config.goals.source}' (did you mean a longer exploration "
            "or goals.source=walk?)"
        )
    return GoalPlaces(
        torch.tensor(cells)[found],
        views[torch.from_numpy(chosen)[found]],
        int((~found).sum()),
    )


def _choose(
    config: NavigateConfig, truth: GroundTruth, cells: Sequence[Cell], poses: np.ndarray
) -> np.ndarray:
    """Numbers of the pictures of each cell, int ``[K, V]``, -1 without any."""
    places, headings, views = poses[:, :2], poses[:, 2], config.goals.views
    return pick_goal_views(places, headings, cells, truth.distances, num_views=views)


def _walk_for_views(
    config: NavigateConfig, truth: GroundTruth, cells: Sequence[Cell]
) -> tuple[Tensor, np.ndarray]:
    """Views and poses of a scripted walk, of which only those chosen are kept.

    It ends when every walker has visited every cell, or after so many decisions that
    what is missing cannot be reached.
    """
    maze = replace(config.maze, goal=False, blocked=[], apples=0)
    seed, keys = seed_of(config.seed, _WALK), [PIXELS, POSITION, HEADING]
    env = make_env(
        maze, engine=config.engine, batch_size=_WALKERS, seed=seed, privileged=True
    )
    walker = FrontierExpert(
        torch.as_tensor(truth.layout.open_mask),
        world=env.world,
        slot_cells=list(truth.layout.slots.values()),
        init_key=None,
        seed=config.seed,
    )
    views = torch.empty(0, *env.world.view_size, 3, dtype=torch.uint8)
    poses = np.empty((0, 3))
    with closing(env):
        for _ in range(0, _MOST_PER_CELL * len(cells) + _CHUNK, _CHUNK):
            seen = collect_rollout(env, walker, _CHUNK, keep=keys).frames.reshape(-1)
            pose = torch.cat([seen[POSITION], seen[HEADING]], -1)
            views = torch.cat([views, seen[PIXELS]])
            poses = np.concatenate([poses, np.asarray(pose, float)])
            chosen = np.unique(_choose(config, truth, cells, poses))
            kept = chosen[chosen >= 0]
            views, poses = views[kept], poses[kept]
            if walker.visited.all():
                break
    return views, poses


def make_navigation_env(
    config: NavigateConfig, places: GoalPlaces, *, envs: int, seed: int
) -> EnvBase:
    """E mazes with a goal, its pictures, and all that a navigator reads.

    The ground truth is there too, for those who judge and for the oracle.

    Raises:
        SettingsError: if the settings do not fit the maze.
        EngineError: if the engine cannot start.
    """
    cells = [(row, column) for row, column in places.cells.tolist()]
    env = make_env(
        config.maze,
        engine=config.engine,
        batch_size=envs,
        seed=seed,
        privileged=True,
        goal_cells=cells,
    )
    goal_reward = env.world.goal_reward
    assert goal_reward is not None  # mazes have goals
    return TransformedEnv(
        env,
        Compose(
            GoalViews(places.cells, places.views),
            PreviousReward(goal_reward, in_keys=[REWARD]),
            InitTracker(),
        ),
    )
