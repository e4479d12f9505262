"""Show a maze: its plan, what an agent sees in it, and walks to a goal.

    python recipes/tour.py maze=maze3

A path-following oracle, which knows the plan, walks for ``decisions`` decisions.
The run folder (``runs/tour/...``) gets ``plan.png``, ``views.png`` and
``walk.mp4`` (or ``walk.gif``).
"""

from toponav.interrupts import catch_early

catch_early(__name__)

from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from toponav.builders import collect_rollout, make_env
from toponav.config import TourConfig
from toponav.keys import CELL, HEADING, PIXELS, POSITION, RESPAWNED, REWARD
from toponav.launch import recipe
from toponav.plotting import (
    FloorPlan,
    contact_sheet,
    draw_plan,
    render_plan,
    save_figure,
    side_by_side,
    spread_out,
    write_video,
)
from toponav.policies import PathFollower


@recipe("tour", aliases={"scale": "tour"})
def main(settings: TourConfig, folder: Path) -> None:
    """Draw the plan, walk, and write the pictures and the video."""
    # The maze, with the ground truth that the oracle and the pictures need.
    seed, engine = settings.seed, settings.engine
    env = make_env(
        settings.maze, engine=engine, batch_size=1, seed=seed, privileged=True
    )
    try:
        env.reset()
        scene, layout, motion = env.games.scenes[0], env.layout, env.world.motion
        assert motion is not None  # a maze reports poses
        mask = torch.from_numpy(layout.open_mask)
        plan = FloorPlan(
            mask,
            cell_size=motion.cell_size,
            slots=layout.slots,
            closed=scene.blocked,
            start=scene.start,
            goal=scene.goal_cell,
            apples=[layout.cell_of(*place, motion.cell_size) for place in scene.apples],
        )

        # The oracle walks to the goal, from a new start each time.
        oracle = PathFollower(
            mask, world=env.world, slot_cells=list(layout.slots.values())
        )
        env.set_seed(seed)  # the walk begins in the scene of the plan
        with tqdm(total=settings.decisions, unit="decision", desc="walk") as bar:
            walk = collect_rollout(
                env,
                oracle,
                settings.decisions,
                keep=[PIXELS, POSITION, HEADING, CELL],
                keep_next=[RESPAWNED, REWARD],
                progress=bar.update,
            ).frames[0]
    finally:
        env.close()
    positions, headings = walk[POSITION].numpy(), walk[HEADING].squeeze(-1).numpy()
    views = walk[PIXELS].numpy()

    # The plan alone, and views from places that lie far apart.
    title = f"{layout.name}: {layout.num_cells} cells"
    save_figure(draw_plan(plan, title=title), folder / "plan.png")
    chosen = spread_out(positions, headings, settings.views, cell_size=plan.cell_size)
    sheet = contact_sheet(views[chosen], positions[chosen], headings[chosen], plan=plan)
    save_figure(sheet, folder / "views.png")

    # The walk: first person beside the moving arrow.
    video = folder / f"walk.{settings.video}"
    walked = render_plan(plan, positions, headings, height=settings.height)
    frames = side_by_side(views, walked)
    write_video(video, tqdm(frames, total=len(views), unit="frame", desc=video.name))

    goals = int(walk["next", *RESPAWNED].sum())
    reward = float(walk["next", REWARD].sum())
    seen = len(np.unique(walk[CELL].numpy(), axis=0))
    print(
        f"{layout.name}: {settings.decisions} decisions, {goals} goals, reward "
        f"{reward:g}, {seen} of {layout.num_cells} cells; pictures in {folder}"
    )


if __name__ == "__main__":
    main()
