"""`pick_goal_views`: which pictures show the places where a goal can be."""

import numpy as np
from numpy.typing import ArrayLike

from toponav.ground_truth.distances import GroundTruthDistances, Ints

# Cells of distance that a degree off counts like: 90 degrees like 0.7 cells.
_CELLS_PER_DEGREE = 1 / 128


def pick_goal_views(
    positions: ArrayLike,
    headings: ArrayLike,
    cells: ArrayLike,
    distances: GroundTruthDistances,
    *,
    num_views: int = 4,
    reach: float = 0.75,
) -> Ints:
    """The pictures of K places in V directions from east on, int ``[K, V]``, or -1.

    Of all pictures, taken at ``positions`` ``[P, 2]`` in map units with ``headings``
    ``[P]`` in degrees, those up to ``reach`` cells on foot from the middle of a place,
    one of ``cells`` ``[K, 2]``, are ranked by both distance and direction.

    Examples:
        >>> import torch
        >>> distances = GroundTruthDistances(torch.ones(1, 3).bool(), cell_size=10)
        >>> taken, looking = [[5.0, 5.0], [6.0, 5.0], [15.0, 5.0]], [0.0, 180, 90]
        >>> pick_goal_views(taken, looking, [[0, 0]], distances, num_views=2)
        array([[0, 1]])
    """
    taken, looking = np.asarray(positions, float), np.asarray(headings, float)
    wanted = np.arange(num_views) * 360 / num_views
    off = np.abs((looking[:, None] - wanted + 180) % 360 - 180)
    chosen = []
    for middle in distances.centres(cells):
        away = distances.distance(taken, np.broadcast_to(middle, taken.shape))
        cost = away[:, None] + off * _CELLS_PER_DEGREE * distances.cell_size
        cost[away > reach * distances.cell_size] = np.inf
        best = cost.argmin(0)
        chosen.append(np.where(np.isfinite(cost.min(0)), best, -1))
    return np.stack(chosen)
