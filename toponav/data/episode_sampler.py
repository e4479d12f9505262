"""`EpisodeSampler` and `SplitPairs`: frames of a replay buffer by a rule, in pairs."""

from typing import Protocol

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data.replay_buffers import Sampler, Storage
from torchrl.envs.transforms import Transform

from toponav.data.episodes import Episodes, find_episodes
from toponav.keys import ANCHOR, NETWORK_PIXELS, OTHER


class DrawRule(Protocol):
    """Chooses frames; `TCPairs`, `LPairs` and `Chunks` are such rules."""

    def draw(
        self, episodes: Episodes, batch_size: int, generator: torch.Generator | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Places in ``episodes.order``, of any shape, and entries to add by key."""


class EpisodeSampler(Sampler):
    """Draw frames from whole episodes of a replay buffer, by a rule.

    TorchRL's ``SliceSampler`` gives one stretch of fixed length per draw, but the two
    views of a pair may be an episode apart. The list of episodes is rebuilt after a
    write, not per draw. Random numbers are the buffer's: ``buffer.set_rng(generator)``.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> from toponav.data import Chunks
        >>> buffer = TensorDictReplayBuffer(
        ...     storage=LazyTensorStorage(100), sampler=EpisodeSampler(Chunks(2, 5))
        ... )
        >>> frames = TensorDict({"step_count": torch.arange(60)}, [60])
        >>> _ = buffer.extend(frames.set(("collector", "traj_ids"), torch.zeros(60)))
        >>> buffer.sample(20).batch_size
        torch.Size([2, 10])
    """

    def __init__(self, rule: DrawRule) -> None:
        self.rule = rule
        self._episodes: Episodes | None = None

    def sample(
        self, storage: Storage, batch_size: int
    ) -> tuple[Tensor | tuple[Tensor, ...], dict[str, Tensor]]:
        if self._episodes is None:
            self._episodes = find_episodes(storage)
        place, info = self.rule.draw(self._episodes, batch_size, self._rng)
        row = self._episodes.order[place]
        if storage.ndim == 1:
            return row, info
        return torch.unravel_index(row, storage.shape), info

    def _forget(self, *args: object, **kwargs: object) -> None:
        self._episodes = None

    # The buffer calls these when its content changed.
    add = extend = mark_update = _empty = load_state_dict = loads = _forget

    # Nothing to keep: the list of episodes follows from the storage.
    def state_dict(self) -> dict[str, Tensor]:
        return {}

    def dumps(self, path: object) -> None:
        pass


class SplitPairs(Transform):
    """Turn a sample of pairs, batch ``[P, 2]``, into one of batch ``[P]``.

    For a replay buffer whose `EpisodeSampler` draws `TCPairs` or `LPairs`. The entry
    ``in_key`` ``[P, 2, *D]`` of the two frames becomes ``anchor`` and ``other``; of all
    else, such as the action, the anchor's is kept.

    Examples:
        >>> from tensordict import TensorDict
        >>> pairs = TensorDict({"network_pixels": torch.zeros(64, 2, 6, 8, 3)}, [64, 2])
        >>> SplitPairs()(pairs)["anchor"].shape
        torch.Size([64, 6, 8, 3])
    """

    def __init__(self, in_key: NestedKey = NETWORK_PIXELS) -> None:
        super().__init__(in_keys=[in_key], out_keys=[ANCHOR, OTHER])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if tensordict.ndim < 2 or tensordict.shape[-1] != 2:
            raise ValueError(
                f"the sample must be of pairs, batch size [P, 2], got "
                f"{list(tensordict.shape)}; give the buffer EpisodeSampler(TCPairs())"
            )
        (in_key,) = self.in_keys
        first, second = tensordict.unbind(-1)
        pairs = first.exclude(in_key)
        return pairs.update({ANCHOR: first.get(in_key), OTHER: second.get(in_key)})
