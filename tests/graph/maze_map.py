"""Maps as large as one likes, over the plan of a maze, without an engine."""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from toponav.envs import load_maze
from toponav.ground_truth import GroundTruthDistances

#: Of each waypoint to others, as in a map that grew; share of the edges that were only
#: seen, and of those that are false.
EDGES, SEEN, FALSE = 5, 0.1, 0.003
CELL_SIZE = 128.0


@dataclass(frozen=True)
class MazeMap:
    """A map by the truth."""

    mask: Tensor  # bool [rows, cols], true where there is floor
    poses: Tensor  # float32 [W, 3], x and y in map units, and degrees
    edges: Tensor  # int64 [E, 2], the lower waypoint first, sorted
    cost: Tensor  # float32 [E]; 1 was walked, 3 only seen
    spurious: Tensor  # bool [E]


def make_maze_map(num: int, *, maze: str = "maze3", seed: int = 0) -> MazeMap:
    """Waypoints all over a maze's floor; edges up to a cell long, some false ones.

    An edge joins what is at most two cells apart on foot, or is spurious.
    """
    draw = np.random.default_rng(seed)
    mask = torch.as_tensor(load_maze(maze).open_mask)
    distances = GroundTruthDistances(mask, cell_size=CELL_SIZE)
    row, column = mask.numpy().nonzero()
    cell = draw.integers(len(row), size=num)
    # The agent's middle keeps an eighth of a cell from walls.
    inside = draw.uniform(0.125, 0.875, (2, num))
    x, y = column[cell] + inside[0], len(mask) - 1 - row[cell] + inside[1]
    places = CELL_SIZE * np.stack([x, y], 1)
    poses = torch.tensor(np.c_[places, draw.uniform(0, 360, num)]).float()

    tree = KDTree(places)
    few = min(num, 2 * EDGES + 1)
    reach = np.maximum(tree.query(places, few)[0][:, -1], CELL_SIZE)
    near = [draw.permutation(some) for some in tree.query_ball_point(places, reach)]
    ends = [(one, other) for one, some in enumerate(near) for other in some[:few]]
    ends = torch.tensor(np.unique(np.sort(ends, 1), axis=0))
    ends = ends[ends[:, 0] != ends[:, 1]]
    ends = ends[distances.geodesic(*poses[ends.T, :2]) <= 2 * CELL_SIZE]
    ends = ends[torch.from_numpy(draw.permutation(len(ends))[: EDGES * num])]

    wrong = torch.from_numpy(
        draw.integers(num, size=(max(1, round(FALSE * len(ends))), 2))
    )
    far = distances.geodesic(*poses[wrong.T, :2]) > 3 * CELL_SIZE
    ends = torch.cat([ends, wrong[far].sort(1).values]).unique(dim=0)
    spurious = distances.geodesic(*poses[ends.T, :2]) > 3 * CELL_SIZE
    seen = torch.from_numpy(draw.random(len(ends)) < SEEN)
    return MazeMap(mask, poses, ends, torch.where(seen, 3.0, 1.0), spurious)
