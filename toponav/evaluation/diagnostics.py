"""Why an explorer explores, or does not: functions of finished episodes.

- `correlation`: does the return rise with the coverage, over episodes?
- `reward_by_new_cells`: does the reward come with new cells, within an episode?
- `occupancy`: where does the agent spend its time?
- `effective_cells`: over how many cells does it spread it?
"""

from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from toponav.evaluation.statistics import Floats


def correlation(first: ArrayLike, second: ArrayLike) -> float:
    """Pearson's correlation; pairs with a NaN are left out.

    A reward that is hacked keeps rising while coverage falls: the correlation of
    return and coverage over episodes then goes towards 0 and below.

    Args:
        first: ``[N]``, such as the intrinsic return of each episode.
        second: ``[N]``, such as its coverage.

    Returns:
        In [-1, 1]; NaN with fewer than three pairs or if one side is constant.

    Raises:
        ValueError: if the lengths differ.

    Examples:
        >>> round(correlation([1, 2, 3], [2, 4, 7]), 3)
        0.993
    """
    x, y = (np.asarray(side, np.float64).reshape(-1) for side in (first, second))
    if len(x) != len(y):
        raise ValueError(f"both sides must have one length, got {len(x)} and {len(y)}")
    both = np.isfinite(x) & np.isfinite(y)
    x, y = x[both], y[both]
    if len(x) < 3:
        return float("nan")
    x, y = x - x.mean(), y - y.mean()
    # Relative to the values' own size: rounding leaves a constant a bit above 0.
    scale = np.linalg.norm(x) * np.linalg.norm(y)
    if np.ptp(x) < 1e-12 or np.ptp(y) < 1e-12:
        return float("nan")
    return float(np.clip(x @ y / scale, -1, 1))


def first_visits(cells: ArrayLike) -> NDArray[np.bool_]:
    """Which observations are the first in their cell.

    Args:
        cells: int ``[T, 2]``, row and column.

    Returns:
        bool ``[T]``.

    Examples:
        >>> first_visits([[1, 1], [1, 2], [1, 1]]).tolist()
        [True, True, False]
    """
    places = np.asarray(cells, np.int64).reshape(-1, 2)
    _, first = np.unique(places, axis=0, return_index=True)
    found = np.zeros(len(places), bool)
    found[first] = True
    return found


def reward_by_new_cells(
    reward: ArrayLike, cells: ArrayLike, *, window: int = 50
) -> tuple[Floats, NDArray[np.int64]]:
    """Reward and newly visited cells, summed over windows of successive decisions.

    Args:
        reward: ``[T]``.
        cells: int ``[T, 2]``, row and column; the start's cell is not new.
        window: decisions in each sum; a rest at the end is left out.

    Returns:
        The sums of the reward and of the new cells, ``[T // window]`` each.

    Raises:
        ValueError: if the lengths differ or ``window < 1``.

    Examples:
        >>> cells = [[1, 1], [1, 2], [1, 2], [1, 3]]
        >>> sums, new = reward_by_new_cells([0, 5, 1, 3], cells, window=2)
        >>> sums.tolist(), new.tolist()
        ([5.0, 4.0], [1, 1])
    """
    rewards = np.asarray(reward, np.float64).reshape(-1)
    new = first_visits(cells)
    if len(rewards) != len(new):
        raise ValueError(
            f"reward must be as long as cells, {len(new)}, got {len(rewards)}"
        )
    if window < 1:
        raise ValueError(f"window must be at least 1, got {window}")
    new[:1] = False
    whole = len(rewards) // window * window
    sums = rewards[:whole].reshape(-1, window).sum(1)
    return sums, new[:whole].reshape(-1, window).sum(1)


def occupancy(cells: ArrayLike, shape: tuple[int, int]) -> Floats:
    """Share of the time that was spent in each cell.

    Args:
        cells: int ``[*, 2]``, row and column, of any number of episodes.
        shape: rows and columns of the layout.

    Returns:
        ``[rows, columns]``, summing to 1.

    Raises:
        ValueError: if there is no cell or one lies outside.

    Examples:
        >>> occupancy([[0, 0], [0, 1], [0, 1], [0, 1]], (1, 3)).tolist()
        [[0.25, 0.75, 0.0]]
    """
    places = np.asarray(cells, np.int64).reshape(-1, 2)
    if not len(places):
        raise ValueError("cells must have at least one entry, got none")
    if (places < 0).any() or (places >= shape).any():
        raise ValueError(
            f"cells must lie in a layout of {shape}, got {places.min(0).tolist()} "
            f"to {places.max(0).tolist()}"
        )
    number = places @ [shape[1], 1]
    count = np.bincount(number, minlength=shape[0] * shape[1])
    return cast(Floats, (count / len(places)).reshape(shape))


def effective_cells(share: ArrayLike) -> float:
    """Number of cells among which equally shared time would be as spread out.

    The exponential of the entropy of the shares: 1 for an agent that stays where it
    is, the number of cells for one that is everywhere equally long.

    Args:
        share: of the time in each cell, any shape, summing to 1.

    Examples:
        >>> effective_cells([0.5, 0.5, 0.0])
        2.0
    """
    shares = np.asarray(share, np.float64).reshape(-1)
    shares = shares[shares > 0]
    return float(np.exp(-(shares * np.log(shares)).sum()))
