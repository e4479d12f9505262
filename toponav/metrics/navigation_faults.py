"""What went wrong in navigation: cuts judged by ground truth, why legs were slow."""

import numpy as np
import pandas as pd

from toponav.ground_truth import GroundTruthDistances
from toponav.metrics.navigation_metrics import NavigationTrace, find_legs
from toponav.metrics.statistics import Bools, Floats, Ints

#: What a decision suffered from, in the order in which it is looked for.
FAULTS = ("lost", "wrong_place", "wrong_goal", "false_edge", "homing", "controller")

# Cells: how far a place may be off, an edge may lead, one stands before a slot, and a
# cut that closes it may lie before it.
_OFF, _FAR, _BEFORE, _NEAR = 2.0, 3.0, 1.5, 3.0


def judge_cuts(
    trace: NavigationTrace, distances: GroundTruthDistances, waypoints: Floats
) -> pd.DataFrame:
    """Judge the edges that an agent closed, a row for each decision that closed some.

    Columns are ``episode``, ``decision`` and ``verdict``: a ``"blockage"`` if closed
    slots make the path between the ends of the edge, or with a slot within three cells
    the path to the goal, at least a cell longer; a ``"false_edge"`` if the ends are
    more than three cells apart even so; else a ``"false_block"``. ``waypoints`` are the
    true positions of the map's waypoints, ``[W, 2]``.
    """
    found = []
    for episode, decision in np.argwhere(trace.cut_from >= 0).tolist():
        at = (episode, decision)
        start, end = waypoints[trace.cut_from[at]], waypoints[trace.cut_to[at]]
        goal, closed = distances.centres(trace.goal_cells[at]), trace.blocked[at]
        slots = distances.centres(np.reshape(distances.slot_cells, (-1, 2))[closed])
        away = np.linalg.norm(slots - start, axis=1) / distances.cell_size
        verdict = "false_block"
        if _is_cut_off(distances, start, end, closed) or (
            (away <= _NEAR).any() and _is_cut_off(distances, start, goal, closed)
        ):
            verdict = "blockage"
        elif float(distances.distance(start, end)) > _FAR * distances.cell_size:
            verdict = "false_edge"
        found.append((episode, decision, verdict))
    return pd.DataFrame(found, columns=["episode", "decision", "verdict"])


def _is_cut_off(
    distances: GroundTruthDistances, start: Floats, end: Floats, closed: Bools
) -> bool:
    try:
        around = float(distances.distance(start, end, closed))
    except ValueError:
        return True
    return around >= float(distances.distance(start, end)) + distances.cell_size


def detection_delays(
    trace: NavigationTrace, distances: GroundTruthDistances, cuts: pd.DataFrame
) -> Ints:
    """Decisions from standing before a closed slot to the first cut of a blockage.

    Int ``[K]``, one for each leg with such a cut, from the first decision of the leg at
    which the agent is within 1.5 cells of the closed slot that is nearest when it cuts.
    ``cuts`` are those of `judge_cuts`.
    """
    delays = []
    blockages = cuts[cuts.verdict == "blockage"]
    for leg in find_legs(trace).itertuples():
        decisions = blockages.decision[blockages.episode == leg.episode]
        inside = decisions[decisions.between(leg.start, leg.end - 1)]
        if inside.empty:
            continue
        first = int(inside.min())
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
    none. ``waypoints`` as in `judge_cuts`.
    """

    def apart(start: Floats, end: Floats) -> Floats:
        return distances.distance(start, end) / distances.cell_size

    at, target, goal = (
        waypoints[number.clip(0)]
        for number in (trace.place, trace.target, trace.goal_node)
    )
    goals = distances.centres(trace.goal_cells)
    suffered = [
        (trace.place < 0) | trace.lost,
        apart(at, trace.positions) > _OFF,
        (trace.goal_node >= 0) & (apart(goal, goals) > _OFF),
        (trace.target >= 0) & (apart(at, target) > _FAR),
        trace.target < 0,
    ]
    return np.select(suffered, range(len(suffered)), FAULTS.index("controller"))


def slow_legs(
    trace: NavigationTrace, faults: Ints, *, limit: int = 250
) -> dict[str, int]:
    """Number of legs of more than ``limit`` decisions by their most frequent fault."""
    legs = find_legs(trace)
    most = [
        np.bincount(faults[leg.episode, leg.start : leg.end]).argmax()
        for leg in legs[legs.decisions > limit].itertuples()
    ]
    count = np.bincount(np.array(most, np.int64), minlength=len(FAULTS))
    return dict(zip(FAULTS, count.tolist(), strict=True))
