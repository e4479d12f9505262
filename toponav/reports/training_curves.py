"""How a training went: the mean of its last episodes, and when it came to a level."""

from collections.abc import Iterable

import numpy as np

from toponav.metrics import AtMost, Floats, decisions_to_reach, running_mean
from toponav.runs import Exploration

#: Episodes over which the coverage (or return) of a training is averaged.
WINDOW = 16


def training_curve(one: Exploration) -> tuple[Floats, Floats]:
    """Decisions, and the mean score of the last episodes; NaN while it has fewer."""
    score = running_mean(one.episodes["score"], WINDOW)
    score[: WINDOW - 1] = np.nan
    return one.episodes["decisions"].to_numpy(np.float64), score


def decisions_until(one: Exploration, level: float) -> float | AtMost:
    """Decisions until the mean of the last episodes covers so much, -1 if never.

    All of the maze counts as soon as one episode covers it. Where the first mean is
    there already, nobody knows how much sooner the explorer was.
    """
    decisions, score = training_curve(one)
    if level >= 100:
        score = one.episodes["score"].to_numpy(np.float64)
    good = np.flatnonzero(score >= level - 1e-6)
    if not len(good):
        return -1.0
    at = float(decisions[good[0]])
    return AtMost(at) if level < 100 and good[0] == WINDOW - 1 else at


def median_until(
    explorations: Iterable[Exploration], level: float, *, before: float = 0.0
) -> float | AtMost:
    """The median over runs of `decisions_until`, and those ``before`` in addition.

    NaN if half of them never get there; `AtMost` where it hangs on runs of which
    nobody knows more.
    """
    found = [decisions_until(one, level) for one in explorations]
    latest = [one.value if isinstance(one, AtMost) else one for one in found]
    earliest = [0.0 if isinstance(one, AtMost) else one for one in found]
    low, high = (decisions_to_reach(all_)[0] + before for all_ in (earliest, latest))
    return AtMost(high) if low < high else high
