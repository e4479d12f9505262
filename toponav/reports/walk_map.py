"""`write_walk_map`: what networks that still train make of a random walk."""

from pathlib import Path

import numpy as np
import torch

from toponav import graph
from toponav.builders import World, one_thread
from toponav.ground_truth import GroundTruthDistances, require_motion
from toponav.keys import HEADING, POSITION
from toponav.metrics import FALSE_EDGE_CELLS, covered_cells, edge_lengths
from toponav.plotting import FloorPlan, draw_topological_map, save_figure
from toponav.training import Validation

# Decisions of the walk; all its pairs of views are compared.
_WALK = 900


def write_walk_map(
    folder: Path, validation: Validation, world: World, progress: str
) -> str | None:
    """Write ``walk.png``: coverage of a held-out random walk, and a map of it.

    The map has the waypoints of the paper's eq. 9, at the share that calibration asks
    for, and an edge wherever the walk went from one waypoint's views to another's.
    ``progress`` says in its title, which is returned, how far the training is. Without
    ground truth there is no plan to draw on, and no picture.
    """
    if world.layout is None or not world.spec.has_truth:
        return None
    held_out, tc = validation.held_out[0], validation.networks.tc
    length = min(_WALK, held_out.length)
    embeddings = validation.embed(tc.encoder, held_out.pixels[:length])
    with validation.autocast, one_thread():
        walk = graph.WalkWaypoints(embeddings, tc)
    found = graph.calibrate_share([walk], target_share=graph.MAP_SHARE)
    times = walk.times(found.threshold)
    # Each view belongs to the earlier waypoint that it resembles most, or is one.
    nearest = walk.later[times].argmax(0)
    nearest[times] = np.arange(len(times))
    steps = np.sort(np.stack([nearest[:-1], nearest[1:]], 1))
    edges = torch.from_numpy(np.unique(steps[steps[:, 0] != steps[:, 1]], axis=0))

    frames = held_out.frames[:length]
    poses = torch.cat([frames.get(POSITION), frames.get(HEADING)], -1)
    mask = world.floor
    cell_size = require_motion(world.spec).cell_size
    metric = GroundTruthDistances(mask, cell_size=cell_size)
    far = edge_lengths(metric, poses[times], edges) > FALSE_EDGE_CELLS * cell_size
    coverage = float(covered_cells(metric, poses).double().mean())
    title = f"{world.name}, {progress}: a random walk of {length:,} decisions covers "
    false = f"{int(far.sum())} of {len(edges)} edges of its map are false"
    title += f"{coverage:.0%};\n{len(times)} waypoints, {false}"
    figure = draw_topological_map(
        poses[times],
        edges,
        torch.ones(len(edges)),
        far,
        plan=FloorPlan(mask, cell_size=cell_size),
        title=title,
    )
    save_figure(figure, folder / "walk.png", dpi=110)
    return title
