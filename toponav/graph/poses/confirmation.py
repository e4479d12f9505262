"""`confirm_closures`: pairs of views that what came before and after them confirms."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from toponav.graph.poses.closures import Closures

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class ConfirmRules:
    """When two closures of the same two walks confirm each other."""

    #: Most decisions between their views, on either walk.
    window: int = 20
    #: Steps that either walk went between them, at least: one alias confirms the next.
    least: float = 3.0
    #: Degrees by which they may disagree on how the walks are turned to each other, and
    #: steps on the way between them, with a share of its length: walls stop an agent.
    turned: float = 30.0
    apart: float = 2.0
    share: float = 0.3
    #: So many others must confirm one, of those that passed the time before.
    times: int = 2
    passes: int = 2


def confirm_closures(
    closures: Closures,
    walk_of: Numbers,
    headings: Floats,
    positions: Floats,
    rules: ConfirmRules,
) -> Closures:
    """Those that others of the same two walks confirm.

    Two corners of a maze may look alike, but rarely so do the corridors that lead there
    and away from there. If both pairs of views show one place each, then the two walks
    went the same way from the one place to the other, seen from either.

    Reference:
        Beyond the paper. Sequences instead of single views: Milford and Wyeth,
        "SeqSLAM" (2012); closures that agree with each other: Mangelson et al.,
        "Pairwise consistent measurement set maximization" (2018).

    Args:
        closures: of the V views of all walks.
        walk_of: the walk of each view, int64 ``[V]``.
        headings: degrees, seen from the first view of the walk, ``[V]``.
        positions: steps, by the actions alone, in the frame of that view, ``[V, 2]``.
        rules: what confirms, and how often.
    """
    walks = walk_of.max() + 1
    for _ in range(rules.passes):
        between = walk_of[closures.one] * walks + walk_of[closures.other]
        times = np.zeros(len(closures), np.int64)
        order = np.argsort(between, kind="stable")
        starts = np.flatnonzero(np.diff(between[order])) + 1
        for some in np.split(order, starts):
            times[some] = _confirmations(
                closures.one[some], closures.other[some], headings, positions, rules
            )
        closures = closures.only(times >= rules.times)
    return closures


def _confirmations(
    one: Numbers,
    other: Numbers,
    headings: Floats,
    positions: Floats,
    rules: ConfirmRules,
) -> Numbers:
    """How many others confirm each of the closures between two walks."""
    # Within the window on both walks at once.
    pairs = KDTree(np.stack([one, other], 1)).query_pairs(
        rules.window, p=np.inf, output_type="ndarray"
    )
    first, second = pairs.T
    turned = headings[one] - headings[other]
    disagree = np.abs((turned[first] - turned[second] + 180) % 360 - 180)
    way = positions[one[second]] - positions[one[first]]
    same = positions[other[second]] - positions[other[first]]
    # Seen as the first walk sees it.
    angle = np.deg2rad(turned[first])
    cos, sin = np.cos(angle), np.sin(angle)
    same = np.stack(
        [same[:, 0] * cos - same[:, 1] * sin, same[:, 0] * sin + same[:, 1] * cos], 1
    )
    length = np.maximum(np.linalg.norm(way, axis=1), np.linalg.norm(same, axis=1))
    apart = np.linalg.norm(way - same, axis=1)
    confirms = (length >= rules.least) & (disagree <= rules.turned)
    confirms &= apart <= rules.apart + rules.share * length
    found: Numbers = np.bincount(pairs[confirms].ravel(), minlength=len(one))
    return found
