"""Means of several runs or episodes that say how sure they are.

- `interquartile_mean`: the mean of the middle half.
- `top_mean`: the mean of the five best, as the paper reports it.
- `bootstrap`: any of them with its 95 % interval.
- `running_mean`: the mean of the last values, of a curve with gaps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
#: Takes the statistic over the last dimension: ``[*B, N]`` to ``[*B]``.
Statistic = Callable[[Floats], Floats]

# Numbers drawn at a time: what a bootstrap holds in memory, 16 MB.
_DRAWN_AT_ONCE = 2_000_000


def mean(values: ArrayLike) -> Floats:
    """Mean over the last dimension, ``[*B, N]`` to ``[*B]``."""
    return cast(Floats, np.asarray(values, np.float64).mean(-1))


def interquartile_mean(values: ArrayLike) -> Floats:
    """Mean of the middle half: a quarter of the values, rounded down, goes at each end.

    One outlying run does not move it, and it wastes less than the median does. Up to
    three values are all kept, so it is then the mean.

    Reference:
        Agarwal et al., "Deep reinforcement learning at the edge of the statistical
        precipice" (2021), section 4. https://arxiv.org/abs/2108.13264

    Args:
        values: ``[*B, N]``, N at least 1.

    Returns:
        float64 ``[*B]``.

    Examples:
        >>> float(interquartile_mean([100, 2, 3, 4, 1]))  # of 2, 3 and 4
        3.0
    """
    ordered = np.sort(np.asarray(values, np.float64), axis=-1)
    cut = ordered.shape[-1] // 4
    return cast(Floats, ordered[..., cut : ordered.shape[-1] - cut].mean(-1))


def top_mean(values: ArrayLike, count: int = 5) -> float:
    """Mean of the ``count`` largest values: what the paper's tables report.

    It grows with the number of values among which the best are looked for, so it
    belongs beside the mean of all, never in its place.

    Args:
        values: any shape, looked at as one list.
        count: how many.

    Raises:
        ValueError: if there are fewer values than ``count``, or ``count < 1``.

    Examples:
        >>> top_mean([1, 9, 2, 8, 3], count=2)
        8.5
    """
    flat = np.sort(np.asarray(values, np.float64), axis=None)
    if not 1 <= count <= len(flat):
        raise ValueError(f"count must lie in [1, {len(flat)}], got {count}")
    return float(flat[len(flat) - count :].mean())


@dataclass(frozen=True)
class Estimate:
    """A statistic and the interval around it.

    Args:
        value: the statistic of the values.
        low: lower end of the interval; NaN if one value leaves nothing to draw.
        high: upper end.
    """

    value: float
    low: float
    high: float


def bootstrap(
    values: ArrayLike,
    statistic: Statistic = mean,
    *,
    level: float = 0.95,
    draws: int = 10_000,
    seed: int = 0,
) -> Estimate:
    """A statistic of runs or episodes, with its percentile bootstrap interval.

    Two seeds of one learner often differ more than two episodes of one seed do. With
    ``[R, E]``, each draw therefore takes R runs with replacement and then, from each of
    them, E episodes with replacement. The interval of one run alone covers the chance
    of its episodes and says nothing about other seeds.

    Reference:
        Efron and Tibshirani, "An introduction to the bootstrap" (1993), chapters 8
        and 13.

    Args:
        values: ``[N]``, or ``[R, E]`` for E episodes of each of R runs.
        statistic: of all values together.
        level: share of the draws inside the interval, in (0, 1).
        draws: how often to draw.
        seed: of the draws.

    Raises:
        ValueError: if there is no value, one is not finite, they are neither ``[N]``
            nor ``[R, E]``, or ``level`` or ``draws`` is out of range.

    Examples:
        >>> found = bootstrap([[0.8, 0.9], [0.7, 0.8]])
        >>> round(found.value, 3), found.low < found.value < found.high
        (0.8, True)
    """
    table = np.asarray(values, np.float64)
    if table.ndim not in (1, 2) or not table.size:
        raise ValueError(f"values must be [N] or [R, E], not empty, got {table.shape}")
    if not np.isfinite(table).all():
        raise ValueError("values must be finite, got some that are not")
    if not 0 < level < 1:
        raise ValueError(f"level must lie in (0, 1), got {level}")
    if draws < 1:
        raise ValueError(f"draws must be at least 1, got {draws}")
    value = float(statistic(table.reshape(-1)))
    if table.size == 1:
        return Estimate(value, float("nan"), float("nan"))
    runs = table.reshape(1, -1) if table.ndim == 1 else table
    generator = np.random.default_rng(seed)
    at_once = max(1, _DRAWN_AT_ONCE // runs.size)
    drawn = [
        statistic(_resample(runs, min(at_once, draws - done), generator))
        for done in range(0, draws, at_once)
    ]
    tail = (1 - level) / 2
    low, high = np.quantile(np.concatenate(drawn), [tail, 1 - tail])
    return Estimate(value, float(low), float(high))


def _resample(runs: Floats, draws: int, generator: np.random.Generator) -> Floats:
    """Draw runs, then episodes of each: ``[R, E]`` to ``[draws, R * E]``."""
    num_runs, num_episodes = runs.shape
    episode = generator.integers(num_episodes, size=(draws, num_runs, num_episodes))
    if num_runs == 1:
        return cast(Floats, runs[0, episode[:, 0]])
    run = generator.integers(num_runs, size=(draws, num_runs, 1))
    return cast(Floats, runs[run, episode].reshape(draws, -1))


def running_mean(values: ArrayLike, window: int) -> Floats:
    """Mean of the last ``window`` values at each place; fewer at the beginning.

    Args:
        values: ``[N]``, in order; NaN where there is none.
        window: how many places to look back, this one included.

    Returns:
        float64 ``[N]``; NaN where the window holds no value.

    Raises:
        ValueError: if ``window < 1`` or the values are not ``[N]``.

    Examples:
        >>> running_mean([2.0, 4.0, float("nan"), 9.0], window=2).tolist()
        [2.0, 3.0, 4.0, 9.0]
    """
    points = np.asarray(values, np.float64)
    if points.ndim != 1:
        raise ValueError(f"values must be [N], got {points.shape}")
    if window < 1:
        raise ValueError(f"window must be at least 1, got {window}")
    known = np.isfinite(points)
    # What came before each place, and what came before its window.
    total = np.concatenate([[0.0], np.cumsum(np.where(known, points, 0.0))])
    count = np.concatenate([[0], np.cumsum(known)])
    end = np.arange(1, len(points) + 1)
    first = np.maximum(end - window, 0)
    inside = count[end] - count[first]
    sums = total[end] - total[first]
    found = np.full(len(points), np.nan)
    np.divide(sums, inside, out=found, where=inside > 0)
    return found
