"""Few waypoints that stand for all views."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from toponav.graph.poses.frames import decisions_apart

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]
#: Similarities ``[P]`` of P views to P waypoints, by the numbers of both.
Alike = Callable[[Numbers, Numbers], Floats]

#: Views whose distances to all waypoints are computed in one call.
_CHUNK = 2048
#: What a multiple may lack of itself as it is divided.
_EVEN = 1e-9


def choose_waypoints(
    poses: Floats,
    alike: Alike,
    *,
    within: float,
    above: float,
    turn: float,
    support: Floats | None = None,
    least: float = 0.0,
    rounding: float = 0.0,
) -> Numbers:
    """Those of W candidates that stand for all, in order.

    A candidate is chosen if none before it is both at most ``within`` decisions away
    and more similar to it than ``above``: eq. 9 with the distance of poses beside that
    of the TC-network, which sees the wall between two places that lie close. One whose
    pose is not known, NaN, is not chosen. Those that others support most come first
    (`find_support`), and a doubted one is chosen only where none at all is near.

    Args:
        poses: of the candidates, ``[W, 3]``.
        alike: similarities of candidates to candidates.
        within: decisions, in free space.
        above: similarity, in [0, 1].
        turn: degrees that the fastest action turns.
        support: of each candidate, ``[W]``; ``None`` takes them as they come.
        least: support below which a candidate is doubted.
        rounding: supports are rounded down to multiples of it, so that of candidates
            that have much the same the first comes first; 0 does not round.

    Examples:
        >>> poses = np.array([[0.0, 0, 0], [3, 0, 0], [3, 0, 60], [np.nan, 0, 0]])
        >>> same = lambda one, other: np.ones(len(one))
        >>> limits = {"within": 4.0, "above": 0.6, "turn": 20.0}
        >>> choose_waypoints(poses, same, **limits).tolist()
        [0, 2]
        >>> choose_waypoints(  # the second stands for both others
        ...     poses, same, **limits, support=np.array([0.5, 0.9, 0.5, 0.9])
        ... ).tolist()
        [1]
    """
    if support is None:
        support = np.full(len(poses), np.inf)
    rank = np.floor(support / rounding + _EVEN) if rounding else support
    is_open = np.atleast_1d(np.isfinite(poses).all(axis=1))
    is_chosen = np.zeros(len(poses), bool)
    for number in np.argsort(-rank, kind="stable").tolist():
        if not is_open[number]:
            continue
        apart = decisions_apart(poses[number], poses, turn)
        if support[number] < least and (is_chosen & (apart <= within)).any():
            continue
        is_chosen[number] = True
        near = np.flatnonzero(is_open & (apart <= within))
        stands_for = alike(near, np.full(len(near), number)) > above
        is_open[near[stands_for]] = False
        is_open[number] = False
    return np.flatnonzero(is_chosen)


def nearest_waypoints(
    views: Floats,
    waypoints: Floats,
    alike: Alike,
    *,
    within: float,
    above: float,
    turn: float,
) -> Numbers:
    """The nearest of W waypoints that each of V views is like, -1 where there is none.

    Arguments as in `choose_waypoints`; ``alike`` compares views with waypoints.
    """
    found = np.full(len(views), -1)
    known = np.flatnonzero(np.isfinite(views).all(axis=1))
    for rows in np.split(known, range(_CHUNK, len(known), _CHUNK)):
        apart = decisions_apart(views[rows, None], waypoints, turn)
        view, waypoint = np.nonzero(apart <= within)
        fits = alike(rows[view], waypoint) > above
        view, waypoint = view[fits], waypoint[fits]
        best = np.full(apart.shape, np.inf)
        best[view, waypoint] = apart[view, waypoint]
        if len(rows) and len(waypoints):
            nearest = best.argmin(1)
            has_one = np.isfinite(best[np.arange(len(rows)), nearest])
            found[rows] = np.where(has_one, nearest, -1)
    return found
