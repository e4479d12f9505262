"""Where an explorer spends its time: `occupancy`, `effective_cells`."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import entropy

from toponav.metrics.statistics import Floats


def occupancy(cells: ArrayLike, shape: tuple[int, int]) -> Floats:
    """Share of the time spent in each cell of a layout, by cells ``[*, 2]``."""
    places = np.asarray(cells, np.int64).reshape(-1, 2)
    if not len(places):
        raise ValueError("cells must have at least one entry, got none")
    if (places < 0).any() or (places >= shape).any():
        got = f"{places.min(0).tolist()} to {places.max(0).tolist()}"
        raise ValueError(f"cells must lie in a layout of {shape}, got {got}")
    count = np.zeros(shape)
    np.add.at(count, tuple(places.T), 1)
    return count / len(places)


def effective_cells(share: ArrayLike) -> float:
    """Number of cells among which equally shared time would be as spread out.

    The exponential of the entropy of the shares, which sum to 1.

    Examples:
        >>> round(effective_cells([0.5, 0.5, 0.0]), 3)
        2.0
    """
    return float(np.exp(entropy(np.ravel(share))))
