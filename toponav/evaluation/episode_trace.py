"""`EpisodeTrace`: one explored episode as arrays, for its numbers and its pictures."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase

from toponav.keys import (
    BORN,
    CELL,
    COUNT_REWARD,
    COVERAGE,
    FALSE_BIRTH,
    HEADING,
    INTRINSIC_REWARD,
    POSITION,
    TEMPORAL_DISTANCE_REWARD,
)


@dataclass(frozen=True)
class EpisodeTrace:
    """The T observations of an episode, the first one included.

    Args:
        positions: ``[T, 2]`` in map units.
        headings: ``[T]`` in degrees.
        cells: int ``[T, 2]``, row and column.
        reward: ``[T]``, the intrinsic reward that came with the observation, 0 with
            the first.
        coverage: ``[T]`` in [0, 1].
        born: bool ``[T]``; the observation became a waypoint.
        false_birth: bool ``[T]``; it did so beside an old one that looks the same way.
        count_reward: ``[T]``, a part of the reward.
        temporal_distance_reward: ``[T]``, the other part.

    Raises:
        ValueError: if the arrays do not have one length, or fewer than two entries.
    """

    positions: NDArray[np.float64]
    headings: NDArray[np.float64]
    cells: NDArray[np.int64]
    reward: NDArray[np.float64]
    coverage: NDArray[np.float64]
    born: NDArray[np.bool_]
    false_birth: NDArray[np.bool_]
    count_reward: NDArray[np.float64]
    temporal_distance_reward: NDArray[np.float64]

    def __post_init__(self) -> None:
        lengths = {name: len(values) for name, values in vars(self).items()}
        if len(set(lengths.values())) > 1 or len(self.positions) < 2:
            raise ValueError(
                f"an episode's arrays must have one length of at least 2, got {lengths}"
            )

    def __len__(self) -> int:
        return len(self.positions)

    def numbers(self) -> dict[str, float]:
        """Coverage, sums of the rewards, and births, by name.

        ``births`` leaves out the first waypoint, which every episode has;
        ``false_births`` are among them, and ``waypoints`` are all.
        """
        return {
            "coverage": float(self.coverage[-1]),
            "intrinsic_return": float(self.reward.sum()),
            "count_return": float(self.count_reward.sum()),
            "temporal_distance_return": float(self.temporal_distance_reward.sum()),
            "births": float(self.born[1:].sum()),
            "false_births": float(self.false_birth[1:].sum()),
            "waypoints": float(self.born.sum()),
        }


def trace_episode(episode: TensorDictBase) -> EpisodeTrace:
    """Read an episode as a rollout or a collector yields it.

    Args:
        episode: ``[T]`` decisions of one episode, with their ``("next", ...)``
            entries and the privileged ones. Of the rewards, births and false births,
            those that are missing are 0.

    Returns:
        The trace of its ``T + 1`` observations.

    Raises:
        ValueError: if it is not ``[T]``.
        KeyError: if position, heading, cell or coverage is missing.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> place = {"position": torch.zeros(4, 2), "heading": torch.zeros(4, 1)}
        >>> place |= {"cell": torch.ones(4, 2).long(), "coverage": torch.ones(4, 1)}
        >>> now = {"privileged": place, "born": torch.ones(4, 1).bool()}
        >>> trace = trace_episode(TensorDict({**now, "next": dict(now)}, [4]))
        >>> len(trace), trace.numbers()["waypoints"]
        (5, 5.0)
    """
    if episode.batch_dims != 1:
        raise ValueError(f"episode must be [T], got {tuple(episode.batch_size)}")

    before, after = episode[:1], episode.get("next")

    def observed(key: NestedKey) -> NDArray[Any]:
        return np.asarray(torch.cat([before[key], after[key]]).cpu())

    def marked(key: NestedKey) -> NDArray[np.bool_]:
        none = torch.zeros(len(episode), 1, dtype=torch.bool)
        marks = [before.get(key, none[:1]), after.get(key, none)]
        return np.asarray(torch.cat([one.cpu() for one in marks])).reshape(-1)

    def paid(key: NestedKey) -> NDArray[np.float64]:
        reward = after.get(key, torch.zeros(len(episode), 1)).reshape(-1)
        return np.concatenate([[0.0], np.asarray(reward.cpu(), np.float64)])

    return EpisodeTrace(
        positions=observed(POSITION).astype(np.float64),
        headings=observed(HEADING).astype(np.float64).reshape(-1),
        cells=observed(CELL),
        reward=paid(INTRINSIC_REWARD),
        coverage=observed(COVERAGE).astype(np.float64).reshape(-1),
        born=marked(BORN),
        false_birth=marked(FALSE_BIRTH),
        count_reward=paid(COUNT_REWARD),
        temporal_distance_reward=paid(TEMPORAL_DISTANCE_REWARD),
    )
