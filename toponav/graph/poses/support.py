"""`find_support`: how far the views of other walks agree with a view at its pose."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from toponav.graph.poses.cover import Alike, Floats, Numbers
from toponav.graph.poses.frames import decisions_apart


@dataclass(frozen=True, kw_only=True)
class SupportRules:
    """Which views are asked and what they count; see *Support* in results/maps.md."""

    within: float = 2.0  # decisions, in free space, up to which a view is asked
    most: int = 24  # of these, drawn by chance
    doubt: float = 2.0  # views unlike the candidate that are added to those asked
    least: float = 0.4  # support below which a candidate is doubted
    #: Supports are rounded down to multiples of it; of equal ones the first is first.
    rounding: float = 0.2
    seed: int = 0  # of the draw


def find_support(
    candidates: Floats,
    walks: Numbers,
    views: Floats,
    walk_of: Numbers,
    alike: Alike,
    *,
    turn: float,
    rules: SupportRules,
) -> Floats:
    """How far views of other walks agree with each of W candidates, ``[W]`` in [0, 1].

    Where a walk's poses are wrong, its views lie among those of other walks, which saw
    something else there. The support is the mean similarity of the candidate to views
    that other walks took at most ``rules.within`` decisions away, as if
    ``rules.doubt`` more of them were unlike it: few views say little.

    Args:
        candidates: their poses, ``[W, 3]``; one that is NaN has no support.
        walks: the walk of each, ``[W]``.
        views: poses of all V views, ``[V, 3]``; those that are NaN are not asked.
        walk_of: the walk of each, ``[V]``.
        alike: similarities of views to candidates.
        turn: degrees that the fastest action turns.
        rules: which views are asked, and what they count.

    Examples:
        >>> views = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, 20], [9, 0, 0]])
        >>> walk_of = np.array([0, 1, 2, 3])
        >>> same = lambda one, other: np.ones(len(one))
        >>> find_support(  # two views agree, 2 / (2 + 2); nobody was near
        ...     views[[0, 3]], walk_of[[0, 3]], views, walk_of, same, turn=20.0,
        ...     rules=SupportRules(),
        ... )
        array([0.5, 0. ])
    """
    known = np.flatnonzero(np.isfinite(views).all(axis=1))
    asked = np.flatnonzero(np.isfinite(candidates).all(axis=1))
    generator = np.random.default_rng(rules.seed)
    tree = KDTree(views[known, :2])
    view, candidate = [], []
    for number in asked.tolist():
        near = tree.query_ball_point(candidates[number, :2], rules.within)
        near = known[np.array(near, np.int64)]
        near = near[walk_of[near] != walks[number]]
        apart = decisions_apart(candidates[number], views[near], turn)
        near = generator.permutation(near[apart <= rules.within])[: rules.most]
        view.append(near)
        candidate.append(np.full(len(near), number))
    of, num = np.concatenate([[], *candidate]).astype(np.int64), len(candidates)
    similar = alike(np.concatenate([[], *view]).astype(np.int64), of)
    agree = np.bincount(of, similar, minlength=num)
    found: Floats = agree / (np.bincount(of, minlength=num) + rules.doubt)
    return found
