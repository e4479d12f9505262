"""What the ground truth says of a map."""

import math

import pytest
import torch

from tests.exploring import explore_settings, world_of
from toponav.ground_truth import WaypointPoses
from toponav.training.map_truth import MapTruth, Snapshot


@pytest.mark.parametrize(("blocked", "false"), [("", 0.0), ("a", 0.5)])
def test_a_slot_that_stays_closed_is_a_wall(blocked: str, false: float) -> None:
    world = world_of(explore_settings("maze=maze1", f"maze.blocked=[{blocked}]"))
    assert world.layout is not None
    cells = list(world.layout.cells)
    if blocked:
        cells.remove(world.layout.slots[blocked])
    # A waypoint in each cell, and two edges: across the slot and away from it.
    middles = [(*world.layout.centre(cell, 128.0), 0.0) for cell in cells]
    north, beyond, south = (cells.index((row, 4)) for row in (7, 6, 9))
    edges = torch.tensor([[north, south], [north, beyond]])

    truth = MapTruth(world)
    truth.poses = WaypointPoses(torch.tensor(middles))
    truth.place(torch.zeros(len(cells), 2, dtype=torch.int64), 700)
    assert truth.decisions_to_cover == 700.0
    now = Snapshot(
        row={},
        state={"edges": edges, "positions": torch.full((len(cells), 2), math.nan)},
        views=[],
        cost=torch.ones(2),
        poses=truth.poses.values,
        decisions_to_cover=truth.decisions_to_cover,
        pretraining_decisions=0.0,
    )
    row = truth.measure(now, truth.lengths(now))
    assert (row["cells"], row["coverage"]) == (len(cells), 1.0)
    assert row["false_edges"] == false
