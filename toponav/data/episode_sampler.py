"""`EpisodeSampler`: a TorchRL sampler that draws frames by a rule over episodes."""

from pathlib import Path
from typing import Protocol

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data.replay_buffers import Sampler, Storage

from toponav.data.episodes import Episodes, find_episodes
from toponav.keys import TRAJECTORY


class DrawRule(Protocol):
    """Chooses frames; `TCPairs`, `LPairs` and `Chunks` are such rules."""

    def draw(
        self, episodes: Episodes, batch_size: int, generator: torch.Generator | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Places in ``episodes.order``, of any shape, and entries to add by key."""


class EpisodeSampler(Sampler):
    """Draw frames from whole episodes of a replay buffer, by a rule.

    TorchRL's ``SliceSampler`` gives one stretch of fixed length per draw. A pair needs
    two places of one episode, up to an episode apart, so the rule draws places from
    the list of episodes instead. The list is rebuilt after a write, not per draw.
    Random numbers are the buffer's: seed them with ``buffer.set_rng(generator)``.

    Args:
        rule: which frames form a batch.
        trajectory_key: see `find_episodes`.
        step_key: see `find_episodes`.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> from toponav.data import Chunks
        >>> buffer = TensorDictReplayBuffer(
        ...     storage=LazyTensorStorage(100), sampler=EpisodeSampler(Chunks(2, 5))
        ... )
        >>> frames = TensorDict({"step_count": torch.arange(60)}, [60])
        >>> _ = buffer.extend(frames.set(TRAJECTORY, torch.zeros(60)))
        >>> buffer.sample(20).batch_size
        torch.Size([2, 10])
    """

    def __init__(
        self,
        rule: DrawRule,
        *,
        trajectory_key: NestedKey = TRAJECTORY,
        step_key: NestedKey = "step_count",
    ) -> None:
        self.rule = rule
        self.trajectory_key = trajectory_key
        self.step_key = step_key
        self._episodes: Episodes | None = None

    def sample(
        self, storage: Storage, batch_size: int
    ) -> tuple[Tensor | tuple[Tensor, ...], dict[str, Tensor]]:
        if self._episodes is None:
            self._episodes = find_episodes(
                storage, trajectory_key=self.trajectory_key, step_key=self.step_key
            )
        place, info = self.rule.draw(self._episodes, batch_size, self._rng)
        row = self._episodes.order[place]
        if storage.ndim == 1:
            return row, info
        return torch.unravel_index(row, storage.shape), info

    # The buffer calls these when its content changed.
    def add(self, index: int) -> None:
        self._episodes = None

    def extend(self, index: Tensor) -> None:
        self._episodes = None

    def mark_update(
        self, index: int | Tensor, *, storage: Storage | None = None
    ) -> None:
        self._episodes = None

    def _empty(self) -> None:
        self._episodes = None

    # Nothing to keep: the list of episodes follows from the storage.
    def state_dict(self) -> dict[str, Tensor]:
        return {}

    def load_state_dict(self, state_dict: dict[str, Tensor]) -> None:
        self._episodes = None

    def dumps(self, path: str | Path) -> None:
        pass

    def loads(self, path: str | Path) -> None:
        self._episodes = None
