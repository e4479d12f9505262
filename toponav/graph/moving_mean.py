"""`moving_mean`: how the views beside one vote with it."""

import numpy as np
from numpy.typing import NDArray


def moving_mean(
    rows: NDArray[np.float32], begin: int, num: int, window: int
) -> NDArray[np.float64]:
    """Mean of rows ``[F, M]`` with those beside them, of ``num`` from ``begin`` on."""
    sums = np.zeros((len(rows) + 1, rows.shape[1]))
    np.cumsum(rows, axis=0, dtype=np.float64, out=sums[1:])
    centre = np.arange(begin, begin + num)
    low = np.maximum(centre - window, 0)
    high = np.minimum(centre + window + 1, len(rows))
    mean: NDArray[np.float64] = (sums[high] - sums[low]) / (high - low)[:, None]
    return mean
