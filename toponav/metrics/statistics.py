"""Means of several runs or episodes, how sure they are, and the rows of sweeps."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from rliable.library import StratifiedBootstrap
from rliable.metrics import aggregate_iqm

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Estimate:
    """A statistic and its interval, whose ends are NaN for a single value."""

    value: float
    low: float
    high: float
    #: Whether the interval is over the episodes of one run alone, or of one seed in
    #: all mazes.
    of_one_run: bool = False

    def __str__(self) -> str:
        if np.isnan(self.low):
            return f"{self.value:.1f}"
        return f"{self.value:.1f} ({self.low:.1f} to {self.high:.1f})"


@dataclass(frozen=True)
class AtMost:
    """A number of decisions of which nobody knows more than that it is no larger."""

    value: float

    def __str__(self) -> str:
        return f"at most {self.value:,.0f}"


class _RunsThenEpisodes(StratifiedBootstrap):
    """Draws runs, then episodes of each in each maze; rliable's draws ignore the seed.

    With ``[R, E]`` there is one maze.
    """

    def update_indices(self) -> tuple[Ints, ...]:
        *mazes, num_runs, num_episodes = self._args_shape
        # The runs of one seed share networks and draws of settings in all mazes.
        run = self.generator.integers(num_runs, size=(num_runs, 1))
        episode = self.generator.integers(num_episodes, size=self._args_shape)
        maze = [np.arange(number)[:, None, None] for number in mazes]
        return (*maze, run, episode)


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
    that of one run alone says nothing about other seeds. With ``[M, R, E]`` it takes
    the same R seeds in all of M mazes, and E episodes of each run: mazes are not drawn,
    the interval is of them alone.

    ``statistic`` is of all values together, such as rliable's ``aggregate_iqm``, and
    ``level`` the share of the ``draws`` inside the interval.

    Reference:
        Agarwal et al., "Deep reinforcement learning at the edge of the statistical
        precipice" (2021), section 4. https://arxiv.org/abs/2108.13264

    Examples:
        >>> found = bootstrap([[0.8, 0.9], [0.7, 0.8]])
        >>> round(found.value, 3), found.low < found.value < found.high
        (0.8, True)
    """
    table = np.asarray(values, np.float64)
    if table.ndim not in (1, 2, 3) or not table.size:
        rule = "values must be [N], [R, E] or [M, R, E], not empty"
        raise ValueError(f"{rule}, got {table.shape}")
    if not np.isfinite(table).all():
        raise ValueError("values must be finite, got some that are not")
    if not 0 < level < 1 or draws < 1:
        got = f"{level} and {draws}"
        raise ValueError(f"level must lie in (0, 1) and draws above 0, got {got}")
    value = float(statistic(table))
    if max(table.shape[-2:]) == 1:
        return Estimate(value, np.nan, np.nan)
    samples = _RunsThenEpisodes(np.atleast_2d(table), seed=seed)
    low, high = samples.conf_int(statistic, draws, method="percentile", size=level)
    of_one_run = table.ndim > 1 and table.shape[-2] == 1
    return Estimate(value, low.item(), high.item(), of_one_run)


def top_mean(values: ArrayLike, count: int = 5) -> float:
    """Mean of the ``count`` largest values, NaN if there are fewer.

    The paper's tables report it. It grows with the number of values, so it belongs
    beside the mean of all, never in its place.
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


@dataclass(frozen=True)
class Scores:
    """One measure of a group of runs that differ in their seeds alone.

    Values are ``[R, E]`` of R runs with E episodes each, ``[R, 1]`` for one value a
    run, or ``[N]`` for episodes that are of no run.
    """

    settings: Mapping[str, str]  # what sets the group apart from the others, by name
    subject: str  # what was measured, such as a policy or a maze
    measure: str  # the name of the values, with their unit
    values: Floats
    #: Other numbers; a name that ends in ``(%)`` gets one decimal place, others none.
    more: Mapping[str, float | AtMost] = field(default_factory=dict)
    #: What was drawn by chance for each of the R runs; empty if nothing was.
    draws: Sequence[str] = ()

    @property
    def best_draws(self) -> list[tuple[float, str]]:
        """Mean and draw of the five best runs, or of all if they are fewer."""
        if len(self.draws) != len(self.values):
            return []
        means = self.values.mean(1).tolist()
        return sorted(zip(means, self.draws, strict=True), reverse=True)[:5]


def drop_unknown(groups: Sequence[Scores], left_out: list[str]) -> list[Scores]:
    """The groups whose values are all numbers; a sentence on others in ``left_out``."""
    known = []
    for one in groups:
        if np.isfinite(one.values).all():
            known.append(one)
            continue
        given = ", ".join(f"{name}={value}" for name, value in one.settings.items())
        of = f"{one.subject} ({given})" if given else one.subject
        sentence = "some of its values are missing or no finite numbers"
        left_out.append(f"{one.measure} of {of} is left out: {sentence}")
    return known


def summarize_scores(
    groups: Sequence[Scores], *, subject: str, unit: str = "values", draws: int = 2000
) -> pd.DataFrame:
    """The table of a sweep, a row for each group.

    ``mean`` and ``iqm``, the interquartile mean, are `Estimate` with 95 % intervals of
    ``draws`` bootstrap samples; ``top_5`` is the mean of the five largest values, NaN
    if there are fewer. Where settings were drawn by chance, ``top_5_draws`` is the mean
    of the five best draws, which the paper keeps. ``subject`` and ``unit`` name the
    columns of the subjects and of the counts.

    Examples:
        >>> values = np.array([[80.0, 90.0], [70.0, 80.0]])
        >>> scores = Scores({"seed": "0"}, "best", "coverage (%)", values)
        >>> table = summarize_scores([scores], subject="policy")
        >>> print(table["mean"][0], table["runs"][0])
        80.0 (72.5 to 87.5) 2
    """
    settings = dict.fromkeys(name for one in groups for name in one.settings)
    more = dict.fromkeys(name for one in groups for name in one.more)
    drawn = ["top_5_draws"] if any(one.draws for one in groups) else []
    return pd.DataFrame(
        {
            **{name: one.settings.get(name, "") for name in settings},
            subject: one.subject,
            "measure": one.measure,
            "mean": bootstrap(one.values, draws=draws),
            "iqm": bootstrap(one.values, aggregate_iqm, draws=draws),
            "top_5": top_mean(one.values),
            **{name: top_mean([best for best, _ in one.best_draws]) for name in drawn},
            **{name: one.more.get(name, math.nan) for name in more},
            "runs": len(one.values) if one.values.ndim == 2 else None,
            unit: one.values.size,
        }
        for one in groups
    )


def decisions_to_reach(decisions: ArrayLike) -> tuple[float, float]:
    """Median of the decisions to a level, and the share of episodes that got there.

    Episodes that did not get there, -1, count as longer than any other: leaving them
    out would reward a policy that seldom arrives. The median is NaN unless more than
    half of the episodes got there.

    Examples:
        >>> decisions_to_reach([400, -1, 900])
        (900.0, 0.6666666666666666)
    """
    taken = np.ravel(np.asarray(decisions, np.float64))
    if not len(taken):
        raise ValueError("decisions must be of at least one episode, got none")
    reached = taken >= 0
    median = float(np.median(np.where(reached, taken, np.inf)))
    return median if math.isfinite(median) else math.nan, float(reached.mean())
