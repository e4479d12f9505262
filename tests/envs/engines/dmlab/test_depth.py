"""Cast depth against the engine's own, which is a z-buffer of 8 bits."""

import numpy as np
import pytest

from tests.envs.layouts import HALL
from tests.envs.test_engines import needs_dmlab
from toponav.envs.depth import DepthCaster
from toponav.envs.engines.dmlab.engine import Engine
from toponav.envs.engines.dmlab.spec import CAMERA, CELL_SIZE, WORLD
from toponav.envs.engines.dmlab.text_level import level_settings, scene_text
from toponav.envs.game import Look
from toponav.envs.scene import SceneRules, draw_scene

#: What is nearer the engine's camera than this, in map units, is not drawn.
NEAR = 4.0
#: Look to the right, look down, strafe, move, fire, jump, crouch.
ARC, BACK = [20, 0, 0, 1, 0, 0, 0], [0, 0, 0, -1, 0, 0, 0]


@needs_dmlab
@pytest.mark.slow
def test_the_engine_measures_the_same_also_while_it_moves() -> None:
    caster = DepthCaster(HALL, WORLD.view_size, camera=CAMERA, cell_size=CELL_SIZE)
    # Pictures hang a little before their walls.
    settings = level_settings(HALL, Look(paintings=0.0))
    engine = Engine(settings, view="RGBD_INTERLEAVED")
    wrong, sky = [], []
    try:
        for seed in range(4):
            generator = np.random.default_rng(seed)
            scene = draw_scene(HALL, SceneRules(), generator, cell_size=CELL_SIZE)
            shown = [engine.reset(scene_text(HALL, settings, scene), idle=36)]
            shown += [engine.act(held, frames=4)[1] for held in (ARC, ARC, ARC, BACK)]
            for view, pose in shown:
                x, y, yaw = (np.array([number]) for number in pose)
                depth = caster.cast(x, y, yaw)[0]
                level = view[..., 3].astype(float)
                # A level says between which two distances a surface lies.
                least, most = (
                    NEAR / np.maximum(1.0 - (level + more) / 255.0, 1e-4)
                    for more in (0, 1)
                )
                is_near = depth < 250
                outside = (depth < 0.98 * least) | (depth > 1.02 * most)
                wrong.append(outside[is_near].mean())
                sky.append(((depth == np.float32(caster.far)) != (level >= 254)).mean())
    finally:
        engine.close()
    assert len(wrong) == 20
    assert max(wrong) < 0.01
    assert max(sky) < 0.01
