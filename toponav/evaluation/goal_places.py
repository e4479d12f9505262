"""`pick_goal_views`: which pictures stand for the places where a goal can be."""

import numpy as np
from numpy.typing import ArrayLike

from toponav.evaluation.navigation_metrics import TrueWays
from toponav.evaluation.navigation_trace import Ints

# How much a direction counts beside a distance: 90 degrees off like 0.7 cells away.
_UNITS_PER_DEGREE = 1.0


def pick_goal_views(
    positions: ArrayLike,
    headings: ArrayLike,
    cells: ArrayLike,
    ways: TrueWays,
    *,
    num_views: int = 4,
    reach: float = 0.75,
) -> Ints:
    """Choose pictures of each place, taken near its middle in different directions.

    Who poses the task chooses, and so may know where the pictures were taken. The agent
    gets the pictures and nothing else.

    Args:
        positions: ``[P, 2]``, where the pictures were taken, in map units.
        headings: ``[P]``, in which direction, in degrees.
        cells: int ``[K, 2]``, row and column of the places.
        ways: true distances.
        num_views: V; directions at equal angles, from east on.
        reach: cells that a picture may be away from the middle, along the floor.

    Returns:
        int ``[K, V]``, numbers of pictures, each of them as often as it is the best for
        a direction; -1 for a place without any.

    Examples:
        >>> import torch
        >>> ways = TrueWays(torch.ones(1, 3).bool())
        >>> taken, looking = [[64.0, 64.0], [70.0, 64.0], [192.0, 64.0]], [0.0, 180, 90]
        >>> pick_goal_views(taken, looking, [[0, 0], [0, 2]], ways, num_views=2)
        array([[ 0,  1],
               [-1, -1]])
    """
    taken, looking = np.asarray(positions, float), np.asarray(headings, float)
    wanted = np.arange(num_views) * 360 / num_views
    off = np.abs((looking[:, None] - wanted + 180) % 360 - 180)
    chosen = []
    for middle in ways.centres(cells):
        away = ways.distance(taken, np.broadcast_to(middle, taken.shape))
        cost = away[:, None] + off * _UNITS_PER_DEGREE
        cost[away > reach * ways.cell_size] = np.inf
        best = cost.argmin(0)
        chosen.append(np.where(np.isfinite(cost.min(0)), best, -1))
    return np.stack(chosen)
