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
    rules = SceneRules(goal=goal is not None, blocked=blocked)
    scene = draw_scene(layout, rules, np.random.default_rng(seed), cell_size=CELL_SIZE)
    scene.start = Pose(*pose)
    scene.apples = apples
    scene.goal = goal
    scene.goal_cell = None if goal is None else layout.cell_of(*goal, CELL_SIZE)
    taken = {scene.goal_cell, *layout.slots.values()}
    scene._start_cells = [cell for cell in layout.cells if cell not in taken]
    return scene
