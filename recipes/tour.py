"""Show a maze: its plan, what an agent sees in it, and a walk from goal to goal.

    python recipes/tour.py maze=maze3

A path-following oracle, which knows the plan, walks for ``decisions`` decisions.
The run folder (``runs/tour/...``) gets ``plan.png``, ``views.png`` and
``walk.mp4`` (or ``walk.gif``).
"""

from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from tqdm import tqdm

from toponav.builders import make_env
from toponav.config import TourConfig
from toponav.evaluation import (
    PathFollower,
    PlanRenderer,
    contact_sheet,
    draw_plan,
    side_by_side,
    spread_out,
    write_video,
)
from toponav.keys import CELL, HEADING, PIXELS, POSITION, RESPAWNED, REWARD
from toponav.launch import recipe


@recipe("tour")
def main(settings: TourConfig, folder: Path) -> None:
    """Draw the plan, walk, and write the pictures and the video."""
    # The maze, with the truth that the oracle and the pictures need.
    env = make_env(settings.maze, seed=settings.seed, privileged=True)
    try:
        first = env.reset()
        scene, layout = env.scenes[0], env.layout
        mask = torch.from_numpy(layout.open_mask)
        plan = partial(
            draw_plan,
            open_mask=mask,
            slots=layout.slots,
            closed=scene.blocked,
            start=scene.start,
            goal=scene.goal_cell,
            apples=[layout.cell_of(*place) for place in scene.apples],
        )

        # The oracle's walk: to the goal, from there to the next, and so on.
        oracle = PathFollower(mask, slot_cells=list(layout.slots.values()))
        with tqdm(total=settings.decisions, unit="decision", desc="walk") as bar:
            walk = env.rollout(
                settings.decisions,
                oracle,
                auto_reset=False,
                tensordict=first,
                break_when_any_done=False,
                callback=lambda *_: bar.update(),
            )
            bar.update()  # the last decision has no callback
    finally:
        env.close()
    positions, headings = walk[POSITION].numpy(), walk[HEADING].squeeze(-1).numpy()
    views = walk[PIXELS].numpy()

    # The plan alone.
    figure, axes = plt.subplots(figsize=(7, 6), layout="constrained")
    plan(axes)
    axes.set_title(f"{layout.name}: {layout.num_cells} cells")
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0))
    figure.savefig(folder / "plan.png", dpi=150)

    # Views from places that lie far apart, and where they were taken.
    chosen = spread_out(positions, headings, settings.views)
    sheet = contact_sheet(views[chosen], positions[chosen], headings[chosen], draw=plan)
    sheet.savefig(folder / "views.png", dpi=150)

    # The walk: first person beside the moving dot.
    video = folder / f"walk.{settings.video}"
    renderer = PlanRenderer(plan, height=settings.height)
    frames = side_by_side(views, renderer.walk(positions, headings))
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
