"""The largest mazes that scaling.py measures, on the engine itself."""

from contextlib import closing

import pytest
import torch
from torchrl.envs import Compose, InitTracker, TransformedEnv

from toponav import keys
from toponav.envs import MazeEnv, make_random_layout
from toponav.policies import FrontierExpert
from toponav.transforms import Coverage


@pytest.mark.parametrize("rooms", [15, 20])
def test_an_expert_walks_on_through_a_large_maze(rooms: int) -> None:
    # R x R rooms are 2 R + 1 cells to a side: 961 and 1,681 of area.
    layout = make_random_layout(rooms, rooms, seed=3)
    side = 2 * rooms + 1
    assert layout.shape == (side, side)
    mask = torch.as_tensor(layout.open_mask)
    base = MazeEnv(layout, batch_size=2, episode_length=1_000, privileged=True, seed=0)
    with closing(TransformedEnv(base, Compose(InitTracker(), Coverage(mask)))) as env:
        expert = FrontierExpert(mask, world=base.world, seed=0)
        played = env.rollout(300, expert)
    cell, covered = played["next", *keys.CELL], played["next", *keys.COVERAGE]
    assert mask[cell[..., 0], cell[..., 1]].all()
    # Four decisions cross a cell, turns take some more: of 300 at least 30 cells.
    cells = covered[:, -1, 0] * mask.sum()
    assert (cells >= 30).all()
    # No view is a wall that was not drawn: pictures differ along the way.
    for row in played["next", keys.PIXELS]:
        assert len(row.flatten(1).unique(dim=0)) > 200
