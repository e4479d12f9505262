"""The moves between waypoints, and which of them become edges."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]
#: How often walks went from one waypoint to another.
Moves = Counter[tuple[int, int]]

#: Steps of the shortest edge.
_LEAST = 1e-6


def count_moves(walks: Iterable[Numbers], *, stay: int = 2) -> Moves:
    """How often walks went from one waypoint to another.

    ``walks`` are the waypoints of successive views; views without one, -1, are skipped,
    and so are visits of fewer than ``stay`` views in a row: a view that looks like a
    place behind a wall is mostly alone.

    Examples:
        >>> count_moves([np.array([0, 0, 1, 1, -1, 1, 2, 0, 0])])
        Counter({(0, 1): 1, (1, 0): 1})
    """
    moves = Moves()
    for walk in walks:
        known = walk[walk >= 0]
        visits = np.split(known, np.flatnonzero(np.diff(known)) + 1)
        stops = [int(visit[0]) for visit in visits if len(visit) >= stay]
        moves.update(pair for pair in pairwise(stops) if pair[0] != pair[1])
    return moves


@dataclass(frozen=True, kw_only=True)
class MoveRules:
    """Which moves become edges.

    The numbers are those of ``results/moves.csv`` and ``results/hanging_maps.csv``.
    """

    often: int = 2  # times, both ways together, from which a move is trusted
    detour: float = 1.5  # most steps by other moves for each step between the ends
    beyond: float = 3.0  # steps that these may be more
    longest: float = 8.0  # steps of a move that is less often made and not needed
    there_and_back: int = 2  # most times, both ways, of the only move of one that hangs
    beside: float = 4.0  # steps within which another waypoint has to stand for it


def trusted_moves(
    moves: Mapping[tuple[int, int], int], positions: Floats, rules: MoveRules
) -> Moves:
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
    counts = _both_ways(moves)
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
    return Moves(
        {
            (one, other): count
            for (one, other), count in moves.items()
            if (min(one, other), max(one, other)) in trusted
        }
    )


def drop_hanging(
    moves: Mapping[tuple[int, int], int], positions: Floats, rules: MoveRules
) -> Moves:
    """Those ``moves`` that do not lead to a waypoint which hangs on one of them.

    A waypoint that walks entered once, or there and back, is mostly a view whose pose
    is a little beside its place: other waypoints stand there, and its edges to them are
    missing. It hangs if its only move was made at most ``there_and_back`` times. Its
    move goes if the waypoint at the other end has moves to others that do not hang, and
    if one that has such moves is within ``beside`` steps: the rest stays joined as it
    was, and the place has a waypoint all the same.

    Args:
        moves: from waypoint to waypoint, how often.
        positions: of the W waypoints in steps, ``[W, 2]``.
        rules: how often is hanging, and how far another waypoint may be.

    Examples:
        >>> positions = np.array([[0.0, 0], [0, 3], [0, 6], [1, 3], [0, 12]])
        >>> moves = {(0, 1): 5, (1, 2): 5, (1, 3): 1, (2, 4): 1}
        >>> sorted(drop_hanging(moves, positions, MoveRules()))
        [(0, 1), (1, 2), (2, 4)]
    """
    counts = _both_ways(moves)
    num_moves = Counter(end for pair in counts for end in pair)
    seldom = [pair for pair, count in counts.items() if count <= rules.there_and_back]
    hanging = {end for pair in seldom for end in pair if num_moves[end] == 1}
    firm = {end for pair in counts if hanging.isdisjoint(pair) for end in pair}
    if not firm:
        return Moves(moves)
    stands = positions[sorted(firm)]
    gone = set[int]()
    for pair in seldom:
        for end, other in (pair, pair[::-1]):
            apart = np.linalg.norm(stands - positions[end], axis=1)
            if end in hanging and other in firm and apart.min() <= rules.beside:
                gone.add(end)
    return Moves(
        {pair: count for pair, count in moves.items() if gone.isdisjoint(pair)}
    )


def drop_unjoined(
    moves: Mapping[tuple[int, int], int], num: int
) -> tuple[Numbers, Moves]:
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
    return joined, Moves({(one, other): count for (one, other), count in counts})


def _both_ways(moves: Mapping[tuple[int, int], int]) -> Moves:
    """How often each two waypoints were gone between, the smaller number first."""
    counts = Moves()
    for (one, other), count in moves.items():
        counts[min(one, other), max(one, other)] += count
    return counts


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
