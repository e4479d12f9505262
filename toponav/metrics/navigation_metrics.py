"""How well an agent gets to its goals: how often, how soon, and how straight."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from toponav.ground_truth import GroundTruthDistances
from toponav.metrics.navigation_trace import Leg, NavigationTrace, find_legs
from toponav.metrics.statistics import Bools, Floats, Ints


def goals_reached(trace: NavigationTrace) -> Ints:
    """How often each episode reached its goal, ``[N]``."""
    count: Ints = trace.reached.sum(1).astype(np.int64)
    return count


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


@dataclass(frozen=True)
class LegMeasures:
    """The L legs of a trace, and how long they were and might have been, in map units.

    The last decision of ``walked`` counts as the straight line to the middle of the
    goal's cell; ``optimum`` leads there from the start, around the slots then closed.
    """

    legs: list[Leg]
    walked: Floats  # length of the path taken, [L]
    optimum: Floats  # length of the shortest path, [L]

    @property
    def reached(self) -> Bools:
        return np.array([leg.reached for leg in self.legs], bool)

    @property
    def is_first(self) -> Bools:
        return np.array([leg.start == 0 for leg in self.legs], bool)


def measure_legs(
    trace: NavigationTrace, distances: GroundTruthDistances
) -> LegMeasures:
    """Lengths of all legs, and of the shortest paths."""
    legs = find_legs(trace)
    steps = np.linalg.norm(np.diff(trace.positions, axis=1), axis=2)
    walked, optimum = [], []
    for leg in legs:
        at, last = (leg.episode, leg.start), (leg.episode, leg.end - 1)
        goal = distances.centres(trace.goal_cells[at])
        length = steps[leg.episode, leg.start : leg.end - 1].sum()
        if leg.reached:
            length += np.linalg.norm(trace.positions[last] - goal)
        walked.append(float(length))
        optimum.append(distances.distance(trace.positions[at], goal, trace.blocked[at]))
    return LegMeasures(legs, np.array(walked), np.array(optimum))


def success_weighted_by_length(measures: LegMeasures) -> Floats:
    """SPL of each episode's first leg, ``[N]``: optimum / max(walked, optimum), or 0.

    The other legs are left out: of those, the ones that take long are cut off.

    Reference:
        Anderson et al., "On evaluation of embodied navigation agents" (2018).
        https://arxiv.org/abs/1807.06757
    """
    first = measures.is_first
    walked, optimum = measures.walked[first], measures.optimum[first]
    longest = np.maximum(np.maximum(walked, optimum), 1e-9)
    spl: Floats = measures.reached[first] * optimum / longest
    return spl


def mean_detour(measures: LegMeasures, *, shortest: float) -> float:
    """Mean of walked / optimum over the legs that reached their goal, NaN if none did.

    The ratio of legs with an optimum below ``shortest`` map units says little.
    """
    counted = measures.reached & (measures.optimum >= shortest)
    if not counted.any():
        return float("nan")
    return float((measures.walked[counted] / measures.optimum[counted]).mean())
