"""Few waypoints that stand for all views, and the moves between them."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from toponav.graph.poses.frames import decisions_apart

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]
#: Similarities ``[P]`` of P views to P waypoints, by the numbers of both.
Alike = Callable[[Numbers, Numbers], Floats]

#: Views whose distances to all waypoints are computed in one call.
_CHUNK = 2048
#: Steps of the shortest edge.
_LEAST = 1e-6
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


def count_moves(walks: Iterable[Numbers], *, stay: int = 2) -> Counter[tuple[int, int]]:
    """How often walks went from one waypoint to another.

    ``walks`` are the waypoints of successive views; views without one, -1, are skipped,
    and so are visits of fewer than ``stay`` views in a row: a view that looks like a
    place behind a wall is mostly alone.

    Examples:
        >>> count_moves([np.array([0, 0, 1, 1, -1, 1, 2, 0, 0])])
        Counter({(0, 1): 1, (1, 0): 1})
    """
    moves = Counter[tuple[int, int]]()
    for walk in walks:
        known = walk[walk >= 0]
        visits = np.split(known, np.flatnonzero(np.diff(known)) + 1)
        stops = [int(visit[0]) for visit in visits if len(visit) >= stay]
        moves.update(pair for pair in pairwise(stops) if pair[0] != pair[1])
    return moves


@dataclass(frozen=True, kw_only=True)
class MoveRules:
    """Which moves become edges; the numbers are those of ``results/moves.csv``."""

    often: int = 2  # times, both ways together, from which a move is trusted
    detour: float = 1.5  # most steps by other moves for each step between the ends
    beyond: float = 3.0  # steps that these may be more
    longest: float = 8.0  # steps of a move that is less often made and not needed


def trusted_moves(
    moves: Mapping[tuple[int, int], int], positions: Floats, rules: MoveRules
) -> Counter[tuple[int, int]]:
    """Those ``moves`` that fit the ones that were made often.

    A view that was taken for another place makes a move through a wall, mostly once.
    Moves that were made fewer than ``often`` times, there and back, stay where other
    moves lead from one end to the other by at most ``detour`` times the steps between
    them and ``beyond``, if they are not longer than ``longest``: those skip a place; or
    where nothing else does, the most frequent first.

    Args:
        moves: from waypoint to waypoint, how often.
        positions: of the W waypoints in steps, ``[W, 2]``.
        rules: what is often, and how long the other way may be.

    Examples:
        >>> positions = np.array([[0.0, 0], [0, 9], [9, 9], [9, 0]])
        >>> moves = {(0, 1): 5, (1, 2): 5, (2, 3): 5, (3, 0): 1}
        >>> sorted(trusted_moves(moves, positions, MoveRules(often=2)))
        [(0, 1), (1, 2), (2, 3)]
    """
    counts = Counter[tuple[int, int]]()
    for (one, other), count in moves.items():
        counts[min(one, other), max(one, other)] += count
    trusted = {pair for pair, count in counts.items() if count >= rules.often}
    steps = {
        pair: float(np.linalg.norm(np.subtract(*positions[[*pair]]))) for pair in counts
    }
    rest = sorted(
        counts.keys() - trusted, key=lambda pair: (-counts[pair], steps[pair])
    )
    apart = _path_lengths(trusted, steps, len(positions))
    joined = DisjointSet(range(len(positions)))
    for pair in trusted:
        joined.merge(*pair)
    bridges = []
    for pair in rest:
        if apart[pair] <= rules.detour * steps[pair] + rules.beyond:
            if steps[pair] <= rules.longest:
                trusted.add(pair)
        elif not np.isfinite(apart[pair]):
            bridges.append(pair)
    # What is added may join the ends of others.
    trusted.update(pair for pair in bridges if joined.merge(*pair))
    return Counter(
        {
            (one, other): count
            for (one, other), count in moves.items()
            if (min(one, other), max(one, other)) in trusted
        }
    )


def drop_unjoined(
    moves: Mapping[tuple[int, int], int], num: int
) -> tuple[Numbers, Counter[tuple[int, int]]]:
    """Which of ``num`` waypoints a move joins to another, and the moves among these.

    Nobody could walk to the others. If there are no moves, all stay.

    Examples:
        >>> drop_unjoined({(0, 3): 2, (3, 2): 1}, 4)
        (array([0, 2, 3]), Counter({(0, 2): 2, (2, 1): 1}))
    """
    ends = np.array([*moves], np.int64).reshape(-1, 2)
    joined = np.unique(ends) if len(ends) else np.arange(num)
    pairs = np.searchsorted(joined, ends).tolist()
    counts = zip(pairs, moves.values(), strict=True)
    return joined, Counter({(one, other): count for (one, other), count in counts})


def _path_lengths(
    edges: Iterable[tuple[int, int]], steps: Mapping[tuple[int, int], float], num: int
) -> Floats:
    """Steps from waypoint to waypoint by ``edges``, ``[W, W]``, infinite if none."""
    pairs = np.array([*edges], np.int64).reshape(-1, 2)
    # No edge is of length 0, which would be none.
    lengths = np.array([steps[one, other] for one, other in pairs.tolist()]) + _LEAST
    graph = csr_array((lengths, tuple(pairs.T)), shape=(num, num))
    found: Floats = shortest_path(graph, directed=False)
    return found
