"""What went wrong in navigation: cuts judged by ground truth, why legs were slow."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from toponav.ground_truth import GroundTruthDistances
from toponav.metrics.navigation_trace import NavigationTrace, find_legs
from toponav.metrics.statistics import Bools, Floats, Ints

Verdict = Literal["blockage", "false_edge", "false_block"]
#: What a decision suffered from, in the order in which it is looked for.
FAULTS = ("lost", "wrong_place", "wrong_goal", "false_edge", "homing", "controller")

# Cells: how far a place may be off, an edge may lead, one stands before a slot, and a
# cut that closes it may lie before it.
_OFF, _FAR, _BEFORE, _NEAR = 2.0, 3.0, 1.5, 3.0


@dataclass(frozen=True)
class Cut:
    """Edges that an agent closed in one decision of an episode.

    It is a ``"blockage"`` if closed slots make the path between the ends of the edge,
    or with a slot within three cells the path to the goal, at least a cell longer; a
    ``"false_edge"`` if the ends are more than three cells apart even so; else a
    ``"false_block"``.
    """

    episode: int
    decision: int
    verdict: Verdict


def judge_cuts(
    trace: NavigationTrace, distances: GroundTruthDistances, waypoints: Floats
) -> list[Cut]:
    """Judge all cuts of a trace by the true positions ``[W, 2]`` of the waypoints."""
    found = []
    for episode, decision in np.argwhere(trace.cut_from >= 0).tolist():
        at = (episode, decision)
        start, end = waypoints[trace.cut_from[at]], waypoints[trace.cut_to[at]]
        goal, closed = distances.centres(trace.goal_cells[at]), trace.blocked[at]
        slots = distances.centres(np.reshape(distances.slot_cells, (-1, 2))[closed])
        away = np.linalg.norm(slots - start, axis=1) / distances.cell_size
        is_near = bool((away <= _NEAR).any())
        verdict: Verdict = "false_block"
        if _is_cut_off(distances, start, end, closed) or (
            is_near and _is_cut_off(distances, start, goal, closed)
        ):
            verdict = "blockage"
        elif float(distances.distance(start, end)) > _FAR * distances.cell_size:
            verdict = "false_edge"
        found.append(Cut(episode, decision, verdict))
    return found


def _is_cut_off(
    distances: GroundTruthDistances, start: Floats, end: Floats, closed: Bools
) -> bool:
    try:
        around = float(distances.distance(start, end, closed))
    except ValueError:
        return True
    return around >= float(distances.distance(start, end)) + distances.cell_size


def detection_delays(
    trace: NavigationTrace, distances: GroundTruthDistances, cuts: list[Cut]
) -> Ints:
    """Decisions from standing before a closed slot to the first cut of a blockage.

    Int ``[K]``, one for each leg with such a cut, from the first decision of the leg at
    which the agent is within 1.5 cells of the closed slot that is nearest when it cuts.
    """
    delays = []
    blockages = [cut for cut in cuts if cut.verdict == "blockage"]
    for leg in find_legs(trace):
        decisions = [cut.decision for cut in blockages if cut.episode == leg.episode]
        inside = [one for one in decisions if leg.start <= one < leg.end]
        if not inside:
            continue
        first = min(inside)
        closed = np.flatnonzero(trace.blocked[leg.episode, first])
        slots = distances.centres([distances.slot_cells[slot] for slot in closed])
        walk = trace.positions[leg.episode, leg.start : first + 1]
        away = np.linalg.norm(walk[:, None] - slots, axis=2)
        before = away[:, away[-1].argmin()] <= _BEFORE * distances.cell_size
        if before.any():
            delays.append(first - leg.start - int(before.argmax()))
    return np.array(delays, np.int64)


def classify_decisions(
    trace: NavigationTrace, distances: GroundTruthDistances, waypoints: Floats
) -> Ints:
    """What each decision suffered from: an index into ``FAULTS``, ``[N, T]``.

    ``lost``: the agent has no place. ``wrong_place``: its place is more than two cells
    off. ``wrong_goal``: it plans to a waypoint more than two cells from the goal.
    ``false_edge``: its next target is more than three cells away from its place.
    ``homing``: it is at the goal's waypoint and looks for the goal. ``controller``:
    none. ``waypoints`` are the true positions of the map's waypoints, ``[W, 2]``.
    """
    fault = np.full(trace.place.shape, FAULTS.index("controller"))

    def mark(name: str, where: Bools) -> None:
        fault[where] = FAULTS.index(name)

    def apart(start: Floats, end: Floats) -> Floats:
        return distances.distance(start, end) / distances.cell_size

    # Later marks win: from the last to the first of FAULTS.
    known = (trace.place >= 0) & ~trace.lost
    place, goal = trace.place.clip(0), trace.goal_node.clip(0)
    mark("homing", known & (trace.target < 0))
    far = apart(waypoints[place], waypoints[trace.target.clip(0)]) > _FAR
    mark("false_edge", known & (trace.target >= 0) & far)
    off_goal = apart(waypoints[goal], distances.centres(trace.goal_cells)) > _OFF
    mark("wrong_goal", known & (trace.goal_node >= 0) & off_goal)
    off_place = apart(waypoints[place], trace.positions) > _OFF
    mark("wrong_place", known & off_place)
    mark("lost", ~known)
    return fault


def slow_legs(
    trace: NavigationTrace, faults: Ints, *, limit: int = 250
) -> Mapping[str, int]:
    """Number of legs of more than ``limit`` decisions by their most frequent fault."""
    most = Counter(
        int(np.bincount(faults[leg.episode, leg.start : leg.end]).argmax())
        for leg in find_legs(trace)
        if leg.decisions > limit
    )
    return {name: most[number] for number, name in enumerate(FAULTS)}
