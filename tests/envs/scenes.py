"""Scenes with a chosen start, apples and goal, for games on the real engine."""

import numpy as np

from toponav.envs import Layout
from toponav.envs.engines.doom.spec import CELL_SIZE
from toponav.envs.scene import Pose, Scene, SceneRules, draw_scene

Place = tuple[float, float]


def scene_at(
    layout: Layout,
    pose: tuple[float, float, float],
    *,
    apples: tuple[Place, ...] = (),
    goal: Place | None = None,
    blocked: tuple[str, ...] = (),
    seed: int = 0,
) -> Scene:
    """A scene that begins at a pose (x, y, heading); respawns are drawn by ``seed``."""
    cell = goal and layout.cell_of(*goal, CELL_SIZE)
    rules = SceneRules(
        goal=goal is not None, blocked=blocked, goal_cells=cell and (cell,)
    )
    scene = draw_scene(layout, rules, np.random.default_rng(seed), cell_size=CELL_SIZE)
    scene.start = Pose(*pose)
    scene.apples = apples
    scene.goal = goal
    return scene
