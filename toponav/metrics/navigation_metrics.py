"""How well an agent gets to its goals: how often, how soon, and how straight."""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from toponav.ground_truth import GroundTruthDistances
from toponav.metrics.navigation_trace import NavigationTrace, find_legs
from toponav.metrics.statistics import Floats, Ints


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
