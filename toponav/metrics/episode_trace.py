"""`EpisodeTrace`: one explored episode as arrays, for its numbers and its pictures."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase

from toponav.keys import (
    CELL,
    COUNT_REWARD,
    COVERAGE,
    HEADING,
    INTRINSIC_REWARD,
    IS_NEW_WAYPOINT,
    POSITION,
    SPURIOUS_WAYPOINT,
    TEMPORAL_DISTANCE_REWARD,
)
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
    count_reward: Floats  # [T], a part of the reward
    temporal_distance_reward: Floats  # [T], the other part

    def __post_init__(self) -> None:
        lengths = {name: len(values) for name, values in vars(self).items()}
        if len(set(lengths.values())) > 1 or len(self.positions) < 2:
            raise ValueError(
                f"an episode's arrays must have one length of at least 2, got {lengths}"
            )

    def __len__(self) -> int:
        return len(self.positions)

    def numbers(self) -> dict[str, float]:
        """Sums and numbers by name; the first waypoint, which all have, is not new."""
        return {
            "coverage": float(self.coverage[-1]),
            "intrinsic_return": float(self.reward.sum()),
            "count_return": float(self.count_reward.sum()),
            "temporal_distance_return": float(self.temporal_distance_reward.sum()),
            "new_waypoints": float(self.is_new_waypoint[1:].sum()),
            "spurious_waypoints": float(self.spurious_waypoint[1:].sum()),
            "waypoints": float(self.is_new_waypoint.sum()),
        }


def trace_episode(
    episode: TensorDictBase, *, reward: NestedKey = INTRINSIC_REWARD
) -> EpisodeTrace:
    """The ``T + 1`` observations of an episode ``[T]`` of a rollout or a collector.

    The privileged entries must be there; missing rewards and marks of waypoints are 0.
    ``reward`` is the key of what the explorer learned from.
    """
    if episode.batch_dims != 1:
        raise ValueError(f"episode must be [T], got {tuple(episode.batch_size)}")

    before, after = episode[:1], episode.get("next")

    def observed(key: NestedKey) -> NDArray[Any]:
        return np.asarray(torch.cat([before[key], after[key]]).cpu())

    def marked(key: NestedKey) -> Bools:
        none = torch.zeros(len(episode), 1, dtype=torch.bool)
        marks = [before.get(key, none[:1]), after.get(key, none)]
        return np.asarray(torch.cat([one.cpu() for one in marks])).reshape(-1)

    def rewards(key: NestedKey) -> Floats:
        values = after.get(key, torch.zeros(len(episode), 1)).reshape(-1)
        return np.concatenate([[0.0], np.asarray(values.cpu(), np.float64)])

    return EpisodeTrace(
        positions=observed(POSITION).astype(np.float64),
        headings=observed(HEADING).astype(np.float64).reshape(-1),
        cells=observed(CELL),
        reward=rewards(reward),
        coverage=observed(COVERAGE).astype(np.float64).reshape(-1),
        is_new_waypoint=marked(IS_NEW_WAYPOINT),
        spurious_waypoint=marked(SPURIOUS_WAYPOINT),
        count_reward=rewards(COUNT_REWARD),
        temporal_distance_reward=rewards(TEMPORAL_DISTANCE_REWARD),
    )
