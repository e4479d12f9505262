"""A navigator's episodes: how often, soon and straight it arrives; what went wrong."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from numpy.typing import ArrayLike
from tensordict import NestedKey, TensorDictBase

from toponav import keys
from toponav.ground_truth import GroundTruthDistances
from toponav.metrics.statistics import Bools, Floats, Ints

#: What only a navigator decides.
_DECIDED: dict[str, NestedKey] = {
    "place": keys.PLACE,
    "target": keys.TARGET,
    "goal_node": keys.GOAL_NODE,
    "cut_from": keys.CUT_FROM,
    "cut_to": keys.CUT_TO,
    "lost": keys.LOST,
}
#: What a trace reads at a decision, and what after it.
TRACE_KEYS = [keys.POSITION, keys.HEADING, keys.CELL, keys.GOAL_CELL, keys.BLOCKED]
TRACE_KEYS += _DECIDED.values()
TRACE_NEXT_KEYS = [keys.REWARD, keys.RESPAWNED]

#: What a decision suffered from, in the order in which it is looked for.
FAULTS = ("lost", "wrong_place", "wrong_goal", "false_edge", "homing", "controller")
# Cells: how far a place may be off, an edge may lead, one stands before a slot, and a
# cut that closes it may lie before it.
_OFF, _FAR, _BEFORE, _NEAR = 2.0, 3.0, 1.5, 3.0


@dataclass(frozen=True)
class NavigationTrace:
    """The T decisions of N episodes: where the agent was, and what it decided there.

    What a navigator decides is -1 everywhere for a policy without a map.
    """

    positions: Floats  # [N, T, 2] in map units, before the decision
    headings: Floats  # [N, T] in degrees
    cells: Ints  # [N, T, 2], row and column
    goal_cells: Ints  # [N, T, 2]
    blocked: Bools  # [N, T, S]; the slots that are closed
    reward: Floats  # [N, T], of the task, for the decision
    reached: Bools  # [N, T]; the decision led to the goal
    place: Ints  # [N, T], the waypoint where the agent believed to be, -1 if lost
    target: Ints  # [N, T], the next waypoint, -1 at the goal's own
    goal_node: Ints  # [N, T], the goal waypoint at the end of the path
    cut_from: Ints  # [N, T], start of the edges closed in this decision
    cut_to: Ints  # [N, T], their end
    lost: Bools  # [N, T]

    def __post_init__(self) -> None:
        shapes = {name: values.shape[:2] for name, values in vars(self).items()}
        if len(set(shapes.values())) > 1 or len(self.reward.shape) != 2:
            raise ValueError(f"all arrays must begin with one [N, T], got {shapes}")

    def __len__(self) -> int:
        return len(self.reward)

    @property
    def decisions(self) -> int:
        """T."""
        return int(self.reward.shape[1])


def trace_navigation(episodes: TensorDictBase) -> NavigationTrace:
    """Read episodes ``[N, T]`` as a rollout or a collector yields them.

    The entries of `TRACE_KEYS` and, after each decision, `TRACE_NEXT_KEYS` must be
    there, except those that only a navigator decides.
    """
    if episodes.batch_dims != 2:
        raise ValueError(f"episodes must be [N, T], got {tuple(episodes.batch_size)}")
    shape, after = episodes.batch_size, episodes.get("next")
    decided = {}
    for name, key in _DECIDED.items():
        nothing = torch.full((*shape, 1), False if key == keys.LOST else -1)
        decided[name] = np.asarray(episodes.get(key, nothing).cpu()).reshape(shape)
    return NavigationTrace(
        positions=np.asarray(episodes[keys.POSITION].cpu(), np.float64),
        headings=np.asarray(episodes[keys.HEADING].cpu(), np.float64).reshape(shape),
        cells=np.asarray(episodes[keys.CELL].cpu(), np.int64),
        goal_cells=np.asarray(episodes[keys.GOAL_CELL].cpu(), np.int64),
        blocked=np.asarray(episodes[keys.BLOCKED].cpu(), bool),
        reward=np.asarray(after[keys.REWARD].cpu(), np.float64).reshape(shape),
        reached=np.asarray(after[keys.RESPAWNED].cpu(), bool).reshape(shape),
        **decided,
    )


def find_legs(trace: NavigationTrace) -> pd.DataFrame:
    """The legs of all episodes, a row each; the last of an episode is mostly cut off.

    Columns are ``episode``, the numbers ``start`` of the first decision and ``end`` of
    the one after the last, ``decisions``, and whether the goal was ``reached``.
    """
    is_last = trace.reached.copy()
    is_last[:, -1:] = True
    episode, last = np.nonzero(is_last)
    reached = trace.reached[episode, last]
    legs = pd.DataFrame({"episode": episode, "end": last + 1, "reached": reached})
    legs["start"] = legs.groupby("episode")["end"].shift(fill_value=0)
    return legs.assign(decisions=legs["end"] - legs["start"])


def first_goal(trace: NavigationTrace) -> Ints:
    """Decisions that each episode took to its first goal, ``[N]``; -1 without one."""
    at = trace.reached.argmax(1) + 1
    return np.where(trace.reached.any(1), at, -1)


def success_within(first: ArrayLike, times: ArrayLike) -> Floats:
    """Share of episodes that reached their goal in ``times`` (the paper's Fig. 20).

    Examples:
        >>> success_within([10, -1, 300, 40], [9, 10, 50, 5000]).tolist()
        [0.0, 0.25, 0.5, 0.75]
    """
    decisions, limits = np.asarray(first), np.asarray(times)
    in_time = (decisions[:, None] >= 0) & (decisions[:, None] <= limits)
    share: Floats = in_time.mean(0)
    return share


def measure_legs(
    trace: NavigationTrace, distances: GroundTruthDistances
) -> pd.DataFrame:
    """The table of `find_legs` with their lengths in map units.

    ``walked`` is that of the path taken, whose last decision counts as the straight
    line to the middle of the goal's cell; ``optimum`` is that of the shortest path
    there from the start, around the slots then closed.
    """
    legs = find_legs(trace)
    start, last = (legs.episode, legs.start), (legs.episode, legs.end - 1)
    starts, goals = trace.positions[start], distances.centres(trace.goal_cells[start])
    steps = np.linalg.norm(np.diff(trace.positions, axis=1), axis=2)
    taken = [
        steps[leg.episode, leg.start : leg.end - 1].sum() for leg in legs.itertuples()
    ]
    to_goal = np.linalg.norm(trace.positions[last] - goals, axis=1)
    ends = zip(starts, goals, trace.blocked[start], strict=True)
    return legs.assign(
        walked=taken + to_goal * legs.reached,
        optimum=[float(distances.distance(*one)) for one in ends],
    )


def success_weighted_by_length(legs: pd.DataFrame) -> Floats:
    """SPL of each episode's first leg, ``[N]``: optimum / max(walked, optimum), or 0.

    ``legs`` are those of `measure_legs`. The other ones of an episode are left out: of
    those, the ones that take long are cut off.

    Reference:
        Anderson et al., "On evaluation of embodied navigation agents" (2018).
        https://arxiv.org/abs/1807.06757
    """
    first = legs[legs.start == 0]
    longest = first[["walked", "optimum"]].max(axis=1).clip(lower=1e-9)
    return np.asarray(first.reached * first.optimum / longest)


def mean_detour(legs: pd.DataFrame, *, shortest: float) -> float:
    """Mean of walked / optimum over the legs that reached their goal, NaN if none did.

    The ratio of legs with an optimum below ``shortest`` map units says little.
    """
    counted = legs[legs.reached & (legs.optimum >= shortest)]
    return float((counted.walked / counted.optimum).mean())


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
