"""`EpisodeLog`: finished training episodes, put together from batches."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from toponav import keys
from toponav.builders import Consumer, RewardMethod, World

#: One line of a table: names to numbers, or to words.
Row = dict[str, Any]

#: What pictures of an episode need, of the first observation too, where it is there.
_POSES = (keys.POSITION, keys.HEADING, keys.CELL, keys.COVERAGE)
_WAYPOINTS = (keys.IS_NEW_WAYPOINT, keys.SPURIOUS_WAYPOINT)
_ENDS = (keys.DONE, keys.TERMINATED, keys.TRUNCATED, "step_count")


class EpisodeLog(Consumer):
    """Adds up rewards per environment until its episode ends.

    Batches cut episodes anywhere, and those of several processes come in any order.
    Only whole episodes are counted, those that the world ended (*terminated*) and those
    of full length: not those that were cut short so that not all environments end
    together, nor those that a lost engine ended.
    The reward method names what is summed over an episode, and what is read at its end.
    ``num_envs`` counts the environments of all processes.
    """

    saved = ("rows", "decisions")

    def __init__(self, num_envs: int, world: World, reward: RewardMethod) -> None:
        self.episode_length = world.episode_length
        self.rows: list[Row] = []
        #: The episodes that the last batch finished.
        self.ended: list[Row] = []
        self.decisions = 0
        self.sums, self.ends = reward.episode_sums(), reward.episode_ends()
        summed = list(self.sums.values())
        pictured = [key for key in _WAYPOINTS if key in summed]
        if world.spec.has_truth:
            self.ends = {"coverage": keys.COVERAGE, **self.ends}
            pictured += _POSES
        elif world.spec.has_positions:
            self.ends = {"places": keys.PLACES, **self.ends}
        later = [*summed, *self.ends.values(), *pictured, *_ENDS]
        self.in_keys = [*pictured, keys.TRAJECTORY, *(("next", key) for key in later)]
        self._totals = torch.zeros(len(self.sums), num_envs, dtype=torch.float64)
        self._pieces: list[TensorDictBase] = []
        #: ``[T]``; the last whole episode of the first environment, for pictures.
        self.last_episode: TensorDictBase | None = None

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Count a batch ``[E, T]``; the episodes that it finished are in `ended`.

        Returns:
            What is read at an episode's end, such as coverage and waypoints, of the
            episodes that run so far: means by name, after ``running_``.
        """
        self.decisions += batch.numel()
        later = batch.get("next")
        summed = [later.get(key).squeeze(-1) for key in self.sums.values()]
        rewards = torch.stack(summed).double()
        done, envs = later.get(keys.DONE).squeeze(-1), batch.get(keys.ENV_ID)[:, 0, 0]
        whole = self._are_whole(later)
        self.ended = []
        # A process that died took along what was left of its episodes.
        begins = later.get("step_count")[:, 0, 0] == 1
        self._totals[:, envs[begins]] = 0.0
        if bool((envs[begins] == 0).any()):
            self._pieces = []
        start = torch.zeros(len(envs), dtype=torch.int64)
        for row, time in done.nonzero().tolist():
            span = slice(int(start[row]), time + 1)
            sums = self._totals[:, envs[row]] + rewards[:, row, span].sum(-1)
            self._totals[:, envs[row]] = 0.0
            start[row] = time + 1
            if whole[row, time]:
                self.ended.append(self._row(batch[row, time], sums))
        rest = torch.arange(done.shape[1]) >= start.unsqueeze(-1)
        self._totals[:, envs] += (rewards * rest).sum(-1)
        self._keep_first(batch, envs, done)
        self.rows += self.ended
        return {
            f"running_{name}": float(later.get(key)[:, -1].double().mean())
            for name, key in self.ends.items()
        }

    @property
    def shown_episode(self) -> TensorDictBase | None:
        """``[T]``; the last whole episode of the first environment, or what it began.

        ``None`` before its first batch.
        """
        if self.last_episode is not None or not self._pieces:
            return self.last_episode
        begun = torch.cat(self._pieces)
        return begun if len(begun) else None

    def _row(self, last: TensorDictBase, sums: Tensor) -> Row:
        later, version = last.get("next"), last.get(keys.NETWORKS_VERSION, None)
        return {
            "decisions": self.decisions,
            **dict(zip(self.sums, sums.tolist(), strict=True)),
            **{name: later.get(key).item() for name, key in self.ends.items()},
            "networks_version": 0 if version is None else int(version),
        }

    def running_episodes(self) -> dict[str, Any]:
        pieces = [one.to_dict() for one in self._pieces]
        last = None if self.last_episode is None else self.last_episode.to_dict()
        return {"totals": self._totals, "pieces": pieces, "last": last}

    def resume_episodes(self, state: Mapping[str, Any]) -> None:
        self._totals, last = state["totals"].clone(), state["last"]
        read = partial(TensorDict.from_dict, batch_dims=1)
        self._pieces = [read(one) for one in state["pieces"]]
        self.last_episode = last and read(last)

    def _are_whole(self, later: TensorDictBase) -> Tensor:
        """Which decisions ``[E, T]`` are the last ones of whole episodes."""
        is_last: Tensor = later.get("step_count") == self.episode_length
        return torch.logical_or(is_last, later.get(keys.TERMINATED)).squeeze(-1)

    def _keep_first(self, batch: TensorDictBase, envs: Tensor, done: Tensor) -> None:
        """Keep what the first environment did since its episode began."""
        batch = batch.select(*self.in_keys, strict=False)
        whole = self._are_whole(batch.get("next"))
        for row in (envs == 0).nonzero().flatten().tolist():
            start = 0
            for (time,) in done[row].nonzero().tolist():
                self._pieces.append(batch[row, start : time + 1])
                episode = torch.cat(self._pieces)
                if whole[row, time]:
                    self.last_episode = episode
                self._pieces, start = [], time + 1
            self._pieces.append(batch[row, start:].clone())


def mean_of(rows: Sequence[Row], name: str) -> float:
    """Mean of a column, NaN without rows.

    Examples:
        >>> mean_of([{"coverage": 0.5}, {"coverage": 1.0}], "coverage")
        0.75
    """
    return sum(row[name] for row in rows) / len(rows) if rows else math.nan
