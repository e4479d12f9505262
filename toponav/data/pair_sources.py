"""From a storage to training pairs: `EpisodeSampler`, `MinedPairs`, `DrawnPairs`."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, Protocol

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer, TensorStorage
from torchrl.data.replay_buffers import Sampler, Storage
from torchrl.envs.transforms import Transform

from toponav import keys
from toponav.data.episodes import Episodes, find_episodes
from toponav.data.pair_rules import LPairs, TCPairs, draw_below
from toponav.parts import require_callables, require_parts


@dataclass(frozen=True)
class Chunks:
    """Draw a batch of ``E`` episodes with ``C`` chunks of successive frames each.

    Pairs are mined from it (`TCPairs.mine`): close ones within a chunk, distant ones
    between the chunks of an episode. Episodes are drawn in proportion to their length,
    and not twice in a batch while there are enough; chunks may overlap. A sample is
    ``[E, C * chunk_len]``, with ``episode`` and ``step``.

    Examples:
        >>> episodes = Episodes.from_lengths([50, 80])
        >>> place, extra = Chunks(2, 5).draw(episodes, 20, None)
        >>> place.shape, extra["step"].shape
        (torch.Size([2, 10]), torch.Size([2, 10]))
    """

    chunks_per_episode: int = 4  # C
    chunk_len: int = 5  # frames; more than the largest distance of a positive pair
    min_length: int = 21  # of episodes that are used; TC pairs need more than M * k

    def __post_init__(self) -> None:
        if min(self.chunks_per_episode, self.chunk_len, self.min_length) < 1:
            raise ValueError(f"every number of Chunks must be at least 1, got {self}")

    def draw(
        self, episodes: Episodes, batch_size: int, generator: torch.Generator | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Draw ``batch_size`` frames: places ``[E, C * chunk_len]`` and the keys."""
        per_episode = self.chunks_per_episode * self.chunk_len
        num_episodes = batch_size // per_episode
        if num_episodes < 1 or batch_size % per_episode:
            nearest = max(round(batch_size / per_episode), 1) * per_episode
            raise ValueError(
                f"batch_size must be a multiple of chunks_per_episode * chunk_len = "
                f"{per_episode}, got {batch_size}; the nearest is {nearest}"
            )
        shortest = max(self.min_length, self.chunk_len)
        episodes.require(shortest, "min_length and chunk_len")
        usable = (episodes.length >= shortest).nonzero().squeeze(-1)
        chosen = torch.multinomial(
            episodes.length[usable].double(),
            num_episodes,
            replacement=num_episodes > len(usable),
            generator=generator,
        )
        run = usable[chosen].unsqueeze(-1)
        num_starts = episodes.length[run] - self.chunk_len + 1
        first = draw_below(num_starts.expand(-1, self.chunks_per_episode), generator)
        offset = (first.unsqueeze(-1) + torch.arange(self.chunk_len)).flatten(1)
        return episodes.start[run] + offset, {
            keys.EPISODE: episodes.group_start[run].expand_as(offset),
            keys.STEP: episodes.first_step[run] + offset,
        }


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
    write. Random numbers are the buffer's: ``buffer.set_rng(generator)``.

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
        require_parts(rule, "rule", "TCPairs, LPairs or Chunks", "draw")
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
    ``in_key`` becomes ``anchor`` and ``other``; of all else the anchor's is kept.

    Examples:
        >>> from tensordict import TensorDict
        >>> pairs = TensorDict({"network_pixels": torch.zeros(64, 2, 6, 8, 3)}, [64, 2])
        >>> SplitPairs()(pairs)["anchor"].shape
        torch.Size([64, 6, 8, 3])
    """

    def __init__(self, in_key: NestedKey = keys.NETWORK_PIXELS) -> None:
        super().__init__(in_keys=[in_key], out_keys=[keys.ANCHOR, keys.OTHER])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if tensordict.ndim < 2 or tensordict.shape[-1] != 2:
            got = f"{list(tensordict.shape)}; give the buffer EpisodeSampler(TCPairs())"
            raise ValueError(f"the sample must be of pairs, [P, 2], got {got}")
        (in_key,) = self.in_keys
        anchor, other = keys.read_entry(tensordict, in_key).unbind(tensordict.ndim - 1)
        pairs = tensordict[..., 0].exclude(in_key).set(keys.ANCHOR, anchor)
        return pairs.set(keys.OTHER, other)


#: Views ``[N, H, W, 3]`` to embeddings ``[N, D]``.
Embed = Callable[[Tensor], Tensor]


@dataclass
class MinedPairs:
    """Many pairs from few views: embed some chunks of frames, then pair all of them.

    A call returns pairs *of embeddings* for the TC-network and for the L-network, with
    gradients to the encoders. Of the close and of the distant pairs at most half of
    ``max_pairs`` each are kept, drawn at random. ``chunks`` must fit both rules.
    """

    #: Of frames with views, actions, trajectory and step numbers; or such frames
    #: themselves, of any shape.
    storage: Storage | TensorDictBase
    chunks: Chunks = field(default_factory=Chunks)
    num_frames: int = 320  # in a batch, a multiple of C * chunk_len
    _: KW_ONLY
    tc_pairs: TCPairs = field(default_factory=TCPairs)
    l_pairs: LPairs = field(default_factory=LPairs)
    embed_tc: Embed  # the TC-network's encoder
    embed_l: Embed | None = None  # the L-network's, `None` if both share one
    max_pairs: int = 2048  # of a call for each network, at least 2
    in_key: NestedKey = keys.NETWORK_PIXELS  # of the views
    generator: torch.Generator | None = None  # torch's own by default
    device: torch.device | str = "cpu"  # where the frames are embedded

    def __post_init__(self) -> None:
        if self.max_pairs < 2:
            raise ValueError(f"max_pairs must be at least 2, got {self.max_pairs}")
        require_callables(embed_tc=self.embed_tc, embed_l=self.embed_l)
        wanted = "mine", "max_action_distance", "min_distance"
        for name in ("tc_pairs", "l_pairs"):
            require_parts(getattr(self, name), name, "TCPairs or LPairs", *wanted)
        if isinstance(self.chunks, Chunks):
            self._check_chunks(self.chunks)
        self.buffer = TensorDictReplayBuffer(
            storage=_as_storage(self.storage),
            sampler=EpisodeSampler(self.chunks),
            batch_size=self.num_frames,
            generator=self.generator,
        )

    def _check_chunks(self, chunks: Chunks) -> None:
        """ValueError for chunks that have pairs of the two rules by chance alone."""
        rules = self.tc_pairs, self.l_pairs
        longest = max(rule.max_action_distance for rule in rules)
        if chunks.chunk_len <= longest:
            rule = f"chunk_len must be more than each max_action_distance, {longest}"
            raise ValueError(f"{rule}, got {chunks.chunk_len}")
        apart = self.tc_pairs.min_distance
        if chunks.min_length <= apart and self.tc_pairs.other_episode_share < 1:
            rule = f"min_length must be more than M * k of tc_pairs, {apart}"
            raise ValueError(f"{rule}, got {chunks.min_length}")

    def __call__(self) -> tuple[TensorDictBase, TensorDictBase]:
        frames = self.buffer.sample().flatten().to(self.device)
        views = keys.read_entry(frames, self.in_key)
        frames = frames.exclude(self.in_key).set(keys.EMBEDDING, self.embed_tc(views))
        kept: dict[str, Any] = {
            "max_pairs": self.max_pairs,
            "generator": self.generator,
        }
        tc_pairs = self.tc_pairs.mine(frames, **kept)
        if self.embed_l is not None:
            frames.set(keys.EMBEDDING, self.embed_l(views))
        return tc_pairs, self.l_pairs.mine(frames, **kept)


@dataclass
class DrawnPairs:
    """Pairs drawn one by one, as in the paper: every pair has two views of its own.

    A call returns ``num_pairs`` pairs *of views* for the TC-network and as many for the
    L-network. The other arguments are those of `MinedPairs`.
    """

    storage: Storage | TensorDictBase
    num_pairs: int
    _: KW_ONLY
    tc_pairs: TCPairs = field(default_factory=TCPairs)
    l_pairs: LPairs = field(default_factory=LPairs)
    in_key: NestedKey = keys.NETWORK_PIXELS
    generator: torch.Generator | None = None
    device: torch.device | str = "cpu"

    def __post_init__(self) -> None:
        storage = _as_storage(self.storage)
        self.buffers = [
            TensorDictReplayBuffer(
                storage=storage,
                sampler=EpisodeSampler(rule),
                batch_size=self.num_pairs,
                transform=SplitPairs(self.in_key),
                generator=self.generator,
            )
            for rule in (self.tc_pairs, self.l_pairs)
        ]

    def __call__(self) -> tuple[TensorDictBase, TensorDictBase]:
        tc_pairs, l_pairs = (buffer.sample() for buffer in self.buffers)
        return tc_pairs.to(self.device), l_pairs.to(self.device)


def _as_storage(frames: Storage | TensorDictBase) -> Storage:
    """A storage of these frames, which are not copied; or what is one already."""
    if not isinstance(frames, TensorDictBase):
        require_parts(frames, "storage", "frames or a Storage", "get", "ndim")
        return frames
    return TensorStorage(frames.exclude("next").reshape(-1))
