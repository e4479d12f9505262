"""Means of several runs or episodes, how sure they are, and curves with gaps."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from rliable.library import StratifiedBootstrap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Estimate:
    """A statistic and its interval, whose ends are NaN for a single value."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        if np.isnan(self.low):
            return f"{self.value:.1f}"
        return f"{self.value:.1f} ({self.low:.1f} to {self.high:.1f})"


class _RunsThenEpisodes(StratifiedBootstrap):
    """Draws runs with replacement, then episodes of each run with replacement.

    rliable's own draws take NumPy's global random state and ignore the seed.
    """

    def update_indices(self) -> tuple[Ints, Ints]:
        num_runs, num_episodes = self._args_shape
        run = self.generator.integers(num_runs, size=(num_runs, 1))
        return run, self.generator.integers(num_episodes, size=self._args_shape)


def bootstrap(
    values: ArrayLike,
    statistic: Callable[[Floats], float] = np.mean,
    *,
    level: float = 0.95,
    draws: int = 2000,
    seed: int = 0,
) -> Estimate:
    """A statistic of runs or episodes, with its percentile bootstrap interval.

    Two seeds of one learner often differ more than two episodes of one seed do. With
    ``[R, E]``, each draw therefore takes R runs and then E episodes of each of them;
    that of one run alone says nothing about other seeds.

    Reference:
        Agarwal et al., "Deep reinforcement learning at the edge of the statistical
        precipice" (2021), section 4. https://arxiv.org/abs/2108.13264

    Args:
        values: ``[N]``, or ``[R, E]`` for E episodes of each of R runs; finite.
        statistic: of all values together, such as rliable's ``aggregate_iqm``.
        level: share of the draws inside the interval, in (0, 1).
        draws: number of bootstrap samples.
        seed: of the draws.

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
    if not 0 < level < 1 or draws < 1:
        got = f"{level} and {draws}"
        raise ValueError(f"level must lie in (0, 1) and draws above 0, got {got}")
    value = float(statistic(table))
    if table.size == 1:
        return Estimate(value, np.nan, np.nan)
    samples = _RunsThenEpisodes(np.atleast_2d(table), seed=seed)
    low, high = samples.conf_int(statistic, draws, method="percentile", size=level)
    return Estimate(value, low.item(), high.item())


def top_mean(values: ArrayLike, count: int = 5) -> float:
    """Mean of the ``count`` largest values, NaN if there are fewer.

    The paper's tables report it. It grows with the number of values among which the
    best are picked, so it belongs beside the mean of all, never in its place.
    """
    flat = np.sort(np.asarray(values, np.float64), axis=None)
    return float(flat[-count:].mean()) if len(flat) >= count else np.nan


def running_mean(values: ArrayLike, window: int) -> Floats:
    """Mean of the last ``window`` values ``[N]`` at each place; NaN is left out."""
    if window < 1:
        raise ValueError(f"window must be at least 1, got {window}")
    points = pd.Series(np.asarray(values, np.float64))
    means: Floats = points.rolling(window, min_periods=1).mean().to_numpy()
    return means


def correlation(first: ArrayLike, second: ArrayLike) -> float:
    """Pearson's correlation of two ``[N]``; pairs with a NaN are left out.

    NaN with fewer than three pairs or if one side is constant.
    """
    x, y = (np.asarray(side, np.float64).reshape(-1) for side in (first, second))
    if len(x) != len(y):
        raise ValueError(f"both sides must have one length, got {len(x)} and {len(y)}")
    pairs = np.stack([x, y])[:, np.isfinite(x) & np.isfinite(y)]
    # Rounding leaves the spread of a constant a little above 0.
    if pairs.shape[1] < 3 or np.ptp(pairs, axis=1).min() < 1e-12:
        return np.nan
    return float(np.corrcoef(*pairs)[0, 1])
