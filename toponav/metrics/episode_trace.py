"""One explored episode as arrays, for its numbers and its pictures."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.stats import entropy
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from toponav import keys
from toponav.metrics.statistics import Bools, Floats, Ints


@dataclass(frozen=True)
class EpisodeTrace:
    """The T observations of an episode, the first one included."""

    positions: Floats  # [T, 2] in map units
    headings: Floats  # [T] in degrees
    cells: Ints  # [T, 2], row and column
    reward: Floats  # [T], the intrinsic reward that came with the observation
    coverage: Floats  # [T] in [0, 1]
    is_new_waypoint: Bools  # [T]; the observation became a waypoint
    spurious_waypoint: Bools  # [T]; it did, beside one that looks the same way

    def __len__(self) -> int:
        return len(self.positions)


def trace_episode(
    episode: TensorDictBase, *, reward: NestedKey = keys.INTRINSIC_REWARD
) -> EpisodeTrace:
    """The ``T + 1`` observations of an episode ``[T]`` of a rollout or a collector.

    The privileged entries must be there; a missing reward and marks of waypoints are 0.
    ``reward`` is the key of what the explorer learned from.
    """
    if episode.batch_dims != 1:
        raise ValueError(f"episode must be [T], got {tuple(episode.batch_size)}")
    before, after = episode[:1], episode.get("next")
    none = torch.zeros(len(episode), 1)

    def join(first: Tensor, later: Tensor) -> np.ndarray:
        return torch.cat([first.cpu(), later.cpu()]).numpy()

    def observed(key: NestedKey) -> Floats:
        return join(before[key], after[key]).astype(np.float64)

    def marked(key: NestedKey) -> Bools:
        return join(before.get(key, none[:1]), after.get(key, none)).astype(bool)[:, 0]

    rewards = after.get(reward, none).double()
    return EpisodeTrace(
        positions=observed(keys.POSITION),
        headings=observed(keys.HEADING)[:, 0],
        cells=join(before[keys.CELL], after[keys.CELL]),
        # A reward beside the first observation is of the episode before.
        reward=join(none[:1], rewards)[:, 0],
        coverage=observed(keys.COVERAGE)[:, 0],
        is_new_waypoint=marked(keys.IS_NEW_WAYPOINT),
        spurious_waypoint=marked(keys.SPURIOUS_WAYPOINT),
    )


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
