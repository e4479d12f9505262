"""What went wrong on the way: cuts judged by the truth, and why legs were slow.

- `judge_cuts`: whether what an agent closed was a blockage.
- `detection_delays`: how long it stood before a blockage until it knew.
- `classify_decisions`, `slow_legs`: what kept it from its goal.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from toponav.evaluation.navigation_metrics import TrueWays
from toponav.evaluation.navigation_trace import (
    Floats,
    Ints,
    NavigationTrace,
    find_legs,
)

Verdict = Literal["blockage", "false_edge", "false_block"]
#: What a decision suffered from, in the order in which it is looked for.
FAULTS = ("lost", "wrong_place", "wrong_goal", "false_edge", "homing", "controller")

# Cells: how far a place may be off, an edge may lead, one stands before a slot, and a
# cut that closes it may lie before it.
_OFF, _FAR, _BEFORE, _NEAR = 2.0, 3.0, 1.5, 3.0


@dataclass(frozen=True)
class Cut:
    """Edges that an agent closed.

    Args:
        episode: its number.
        decision: when.
        verdict: ``"blockage"`` if a closed slot makes the way between the ends of the
            edge that failed at least a cell longer, or the way from it to the goal, and
            the slot lies at most three cells away; ``"false_edge"`` if the ends are
            more than three cells apart even so, and the edge should never have been;
            else ``"false_block"``.
    """

    episode: int
    decision: int
    verdict: Verdict


def judge_cuts(trace: NavigationTrace, ways: TrueWays, waypoints: Floats) -> list[Cut]:
    """Judge all cuts of a trace by the truth.

    Args:
        trace: the episodes.
        ways: true distances.
        waypoints: ``[W, 2]``, where the map's waypoints truly are, in map units.
    """
    found = []
    for episode, decision in np.argwhere(trace.cut_from >= 0).tolist():
        at = (episode, decision)
        start, end = waypoints[trace.cut_from[at]], waypoints[trace.cut_to[at]]
        goal, closed = ways.centres(trace.goal_cells[at]), trace.blocked[at]
        slots = ways.centres(np.reshape(ways.slot_cells, (-1, 2))[closed])
        away = np.linalg.norm(slots - start, axis=1) / ways.cell_size
        is_near = bool((away <= _NEAR).any())
        verdict: Verdict = "false_block"
        if _is_cut_off(ways, start, end, closed) or (
            is_near and _is_cut_off(ways, start, goal, closed)
        ):
            verdict = "blockage"
        elif float(ways.distance(start, end)) > _FAR * ways.cell_size:
            verdict = "false_edge"
        found.append(Cut(episode, decision, verdict))
    return found


def _is_cut_off(
    ways: TrueWays, start: Floats, end: Floats, closed: NDArray[np.bool_]
) -> bool:
    """Whether closed slots make a way at least a cell longer."""
    as_open = float(ways.distance(start, end))
    return _distance_beside(ways, start, end, closed) >= as_open + ways.cell_size


def _distance_beside(
    ways: TrueWays, start: Floats, end: Floats, closed: NDArray[np.bool_]
) -> float:
    """Distance around closed slots; infinite if an end lies in one."""
    try:
        return float(ways.distance(start, end, closed))
    except ValueError:
        return float("inf")


def detection_delays(trace: NavigationTrace, ways: TrueWays, cuts: list[Cut]) -> Ints:
    """Decisions from standing before a closed slot to the first cut of a blockage.

    Counted once a leg, from the first decision of the leg at which the agent is within
    1.5 cells of the closed slot that is nearest when it cuts.

    Returns:
        int ``[K]``, one for each leg with such a cut.
    """
    delays = []
    blockages = [cut for cut in cuts if cut.verdict == "blockage"]
    for leg in find_legs(trace):
        inside = [
            cut.decision
            for cut in blockages
            if cut.episode == leg.episode and leg.start <= cut.decision < leg.end
        ]
        if not inside:
            continue
        first = min(inside)
        closed = np.flatnonzero(trace.blocked[leg.episode, first])
        slots = ways.centres([ways.slot_cells[slot] for slot in closed])
        walk = trace.positions[leg.episode, leg.start : first + 1]
        away = np.linalg.norm(walk[:, None] - slots, axis=2)
        before = away[:, away[-1].argmin()] <= _BEFORE * ways.cell_size
        if before.any():
            delays.append(first - leg.start - int(before.argmax()))
    return np.array(delays, np.int64)


def classify_decisions(
    trace: NavigationTrace, ways: TrueWays, waypoints: Floats
) -> NDArray[np.int64]:
    """What each decision suffered from: an index into ``FAULTS``, ``[N, T]``.

    ``lost``: the agent has no place. ``wrong_place``: it believes to be at a waypoint
    more than two cells from where it is. ``wrong_goal``: it walks to a waypoint more
    than two cells from the goal. ``false_edge``: its next target is more than three
    cells away from its place. ``homing``: it is at the goal's waypoint and looks for
    the goal. ``controller``: none of these; the controller has to do its part.

    Args:
        trace: the episodes of an agent with a map.
        ways: true distances.
        waypoints: ``[W, 2]``, where the map's waypoints truly are, in map units.
    """
    fault = np.full(trace.place.shape, FAULTS.index("controller"))

    def mark(name: str, where: NDArray[np.bool_]) -> None:
        fault[where] = FAULTS.index(name)

    def apart(start: Floats, end: Floats) -> Floats:
        return ways.distance(start, end) / ways.cell_size

    # Later marks win: from the last to the first of FAULTS.
    known = (trace.place >= 0) & ~trace.lost
    place, goal = trace.place.clip(0), trace.goal_node.clip(0)
    mark("homing", known & (trace.target < 0))
    far = apart(waypoints[place], waypoints[trace.target.clip(0)]) > _FAR
    mark("false_edge", known & (trace.target >= 0) & far)
    off_goal = apart(waypoints[goal], ways.centres(trace.goal_cells)) > _OFF
    mark("wrong_goal", known & (trace.goal_node >= 0) & off_goal)
    off_place = apart(waypoints[place], trace.positions) > _OFF
    mark("wrong_place", known & off_place)
    mark("lost", ~known)
    return fault


def slow_legs(
    trace: NavigationTrace, faults: NDArray[np.int64], *, limit: int = 250
) -> Mapping[str, int]:
    """Number of slow legs by the fault that took most of their decisions.

    Args:
        trace: the episodes.
        faults: ``[N, T]``, of `classify_decisions`.
        limit: a leg is slow if it takes more decisions.

    Returns:
        A number for each of ``FAULTS``.
    """
    most = Counter(
        int(np.bincount(faults[leg.episode, leg.start : leg.end]).argmax())
        for leg in find_legs(trace)
        if leg.decisions > limit
    )
    return {name: most[number] for number, name in enumerate(FAULTS)}
