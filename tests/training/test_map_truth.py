"""What the ground truth says of a map."""

import math
from dataclasses import replace

import pytest
import torch

from tests.exploring import explore_settings, world_of
from toponav.ground_truth import WaypointPoses
from toponav.training.map_truth import MapTruth, Snapshot
from toponav.training.map_writer import MapWriter


def two_edges(blocked: str) -> tuple[MapTruth, Snapshot]:
    """A waypoint in each cell, and two edges: across a slot and away from it."""
    world = world_of(explore_settings("maze=maze1", f"maze.blocked=[{blocked}]"))
    assert world.layout is not None
    cells = list(world.layout.cells)
    if blocked:
        cells.remove(world.layout.slots[blocked])
    middles = [(*world.layout.centre(cell, 128.0), 0.0) for cell in cells]
    north, beyond, south = (cells.index((row, 4)) for row in (7, 6, 9))
    edges = torch.tensor([[north, south], [north, beyond]])
    truth = MapTruth(world)
    truth.poses = WaypointPoses(torch.tensor(middles))
    truth.place(torch.zeros(len(cells), 2, dtype=torch.int64), 700)
    return truth, Snapshot(
        row={"decisions": 1700},
        state={"edges": edges, "positions": torch.full((len(cells), 2), math.nan)},
        views=[],
        cost=torch.ones(2),
        poses=truth.poses.values,
        decisions_to_cover=truth.decisions_to_cover,
        pretraining_decisions=0.0,
    )


@pytest.mark.parametrize(("blocked", "false"), [("", 0.0), ("a", 0.5)])
def test_a_slot_that_stays_closed_is_a_wall(blocked: str, false: float) -> None:
    truth, now = two_edges(blocked)
    assert truth.decisions_to_cover == 700.0
    row = truth.measure(now, truth.lengths(now))
    assert (row["cells"], row["coverage"]) == (len(now.poses), 1.0)
    assert row["false_edges"] == false


def test_the_title_says_what_false_edges_hold_together() -> None:
    truth, now = two_edges("a")
    # Two edges join three waypoints, and the false one alone joins two of them.
    parts = len(now.poses) - 2
    title = title_of(truth, now)
    assert title == (
        f"maze1 after 1,700 decisions: 100% of the cells, {parts} parts "
        f"({parts + 1} without the false edges, 50.0%)"
    )


def test_one_part_is_no_parts() -> None:
    truth, now = two_edges("a")
    ends, edges = now.state["edges"].unique(return_inverse=True)
    state = {"edges": edges, "positions": now.state["positions"][ends]}
    share = len(ends) / len(now.poses)
    joined = replace(now, poses=now.poses[ends], state=state)
    assert title_of(truth, joined) == (
        f"maze1 after 1,700 decisions: {share:.0%} of the cells, 1 part "
        "(2 without the false edges, 50.0%)"
    )


def title_of(truth: MapTruth, now: Snapshot) -> str:
    """What stands above the map in ``topology.png``."""
    lengths = truth.lengths(now)
    measured = replace(now, row=now.row | truth.measure(now, lengths))
    (axes,) = MapWriter("maze1", truth)._draw(measured, lengths).axes
    return axes.get_title(loc="left")
