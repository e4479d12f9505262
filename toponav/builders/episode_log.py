"""`EpisodeLog`: finished training episodes, put together from batches."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from toponav.keys import (
    BORN,
    COUNT_REWARD,
    COVERAGE,
    DONE,
    ENV_ID,
    FALSE_BIRTH,
    INTRINSIC_REWARD,
    NETWORKS_VERSION,
    NUM_WAYPOINTS,
    TEMPORAL_DISTANCE_REWARD,
)

#: One line of a table: names to numbers, or to words.
Row = dict[str, Any]
#: What is summed over an episode, by its name in the table.
_SUMS: dict[str, NestedKey] = {
    "intrinsic_return": INTRINSIC_REWARD,
    "count_return": COUNT_REWARD,
    "temporal_distance_return": TEMPORAL_DISTANCE_REWARD,
    "births": BORN,
    "false_births": FALSE_BIRTH,
}


class EpisodeLog:
    """Adds up rewards and births per environment until its episode ends.

    Batches cut episodes anywhere, and those of several processes come in any order.
    Only whole episodes are counted: not those that were cut short so that not all
    environments end together, nor those that a lost engine ended.

    Args:
        num_envs: environments over all processes.
        episode_length: decisions of a whole episode.
        rows: finished episodes of an earlier part of the run; new ones are added.

    Shape notation:
        E: environments of a batch.  T: decisions of a rollout.
    """

    def __init__(
        self, num_envs: int, episode_length: int, rows: list[Row] | None = None
    ) -> None:
        self.episode_length = episode_length
        self.rows: list[Row] = [] if rows is None else rows
        self._sums = torch.zeros(len(_SUMS), num_envs, dtype=torch.float64)
        self._pieces: list[TensorDictBase] = []
        #: ``[T]``; the last whole episode of the first environment, for pictures.
        self.last_episode: TensorDictBase | None = None

    def add(self, batch: TensorDictBase, decisions: int) -> list[Row]:
        """Count a batch ``[E, T]``.

        Args:
            batch: what a collector handed over.
            decisions: of the run, this batch included.

        Returns:
            The episodes that it finished; they are in ``rows`` too.
        """
        later = batch.get("next")
        paid = torch.stack([later.get(key).squeeze(-1) for key in _SUMS.values()])
        paid = paid.double()
        done, envs = later.get(DONE).squeeze(-1), batch.get(ENV_ID)[:, 0, 0]
        finished: list[Row] = []
        start = torch.zeros(len(envs), dtype=torch.int64)
        for row, time in done.nonzero().tolist():
            span = slice(int(start[row]), time + 1)
            sums = self._sums[:, envs[row]] + paid[:, row, span].sum(-1)
            self._sums[:, envs[row]] = 0.0
            start[row] = time + 1
            if int(later.get("step_count")[row, time]) == self.episode_length:
                finished.append(self._row(batch[row, time], sums, decisions))
        rest = torch.arange(done.shape[1]) >= start.unsqueeze(-1)
        self._sums[:, envs] += (paid * rest).sum(-1)
        self._follow_first(batch, envs)
        self.rows += finished
        return finished

    def _row(self, last: TensorDictBase, sums: Tensor, decisions: int) -> Row:
        later = last.get("next")
        return {
            "decisions": decisions,
            "coverage": float(later.get(COVERAGE)),
            **dict(zip(_SUMS, sums.tolist(), strict=True)),
            "waypoints": int(later.get(NUM_WAYPOINTS)),
            "networks_version": int(last.get(NETWORKS_VERSION)),
        }

    def _follow_first(self, batch: TensorDictBase, envs: Tensor) -> None:
        """Keep what the first environment did since its episode began."""
        for row in (envs == 0).nonzero().flatten().tolist():
            start = 0
            for time in batch[row].get(("next", DONE)).flatten().nonzero().tolist():
                self._pieces.append(batch[row, start : time[0] + 1])
                episode = torch.cat(self._pieces)
                if len(episode) == self.episode_length:
                    self.last_episode = episode
                self._pieces, start = [], time[0] + 1
            self._pieces.append(batch[row, start:].clone())


def mean_of(rows: Sequence[Row], name: str) -> float:
    """Mean of a column, NaN without rows.

    Examples:
        >>> mean_of([{"coverage": 0.5}, {"coverage": 1.0}], "coverage")
        0.75
    """
    return sum(row[name] for row in rows) / len(rows) if rows else math.nan
