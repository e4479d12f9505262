"""`MinedPairs` and `DrawnPairs`: the two ways from a storage to training pairs."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer
from torchrl.data.replay_buffers import Storage

from toponav.data.chunks import Chunks
from toponav.data.episode_sampler import EpisodeSampler, SplitPairs
from toponav.data.pair_rules import LPairs, TCPairs
from toponav.keys import EMBEDDING, LABEL, NETWORK_PIXELS, WEIGHT

#: Views ``[N, H, W, 3]`` to embeddings ``[N, D]``.
Embed = Callable[[Tensor], Tensor]


@dataclass
class MinedPairs:
    """Many pairs from few views: embed some chunks of frames, then pair all of them.

    A call returns pairs *of embeddings* for the TC-network and for the L-network, with
    gradients to the encoders. Of the close and of the distant pairs at most half of
    ``max_pairs`` each are kept, drawn at random: their number does not depend on k.

    Args:
        storage: frames with views, actions, trajectory and step numbers.
        chunks: the shape of a batch.
        num_frames: frames in a batch, a multiple of ``C * chunk_len``.
        tc_pairs: the TC-network's rule.
        l_pairs: the L-network's rule.
        embed_tc: the TC-network's encoder.
        embed_l: the L-network's, ``None`` if both share one.
        max_pairs: most pairs of a call for each network, at least 2.
        generator: source of the random numbers, torch's own by default.
        device: where the frames go before they are embedded.
    """

    storage: Storage
    chunks: Chunks
    num_frames: int
    _: KW_ONLY
    tc_pairs: TCPairs
    l_pairs: LPairs
    embed_tc: Embed
    embed_l: Embed | None = None
    max_pairs: int = 2048
    generator: torch.Generator | None = None
    device: torch.device | str = "cpu"

    def __post_init__(self) -> None:
        if self.max_pairs < 2:
            raise ValueError(f"max_pairs must be at least 2, got {self.max_pairs}")
        self.buffer = TensorDictReplayBuffer(
            storage=self.storage,
            sampler=EpisodeSampler(self.chunks),
            batch_size=self.num_frames,
            generator=self.generator,
        )

    def __call__(self) -> tuple[TensorDictBase, TensorDictBase]:
        """Pairs of embeddings for the TC-network and for the L-network."""
        frames = self.buffer.sample().flatten()
        views = frames.pop(NETWORK_PIXELS).to(self.device)
        frames.set(EMBEDDING, self.embed_tc(views))
        pairs = self.tc_pairs.mine(frames, generator=self.generator)
        tc_pairs = [
            keep_some(pairs[pairs[LABEL] == label], self.max_pairs // 2, self.generator)
            for label in (1, 0)
        ]
        if self.embed_l is not None:
            frames.set(EMBEDDING, self.embed_l(views))
        l_pairs = self.l_pairs.mine(frames)
        return torch.cat(tc_pairs), keep_some(l_pairs, self.max_pairs, self.generator)


@dataclass
class DrawnPairs:
    """Pairs drawn one by one, as in the paper: every pair has two views of its own.

    A call returns ``num_pairs`` pairs *of views* for the TC-network and as many for the
    L-network. The other arguments are those of `MinedPairs`.
    """

    storage: Storage
    num_pairs: int
    _: KW_ONLY
    tc_pairs: TCPairs
    l_pairs: LPairs
    generator: torch.Generator | None = None
    device: torch.device | str = "cpu"

    def __post_init__(self) -> None:
        self.buffers = [
            TensorDictReplayBuffer(
                storage=self.storage,
                sampler=EpisodeSampler(rule),
                batch_size=self.num_pairs,
                transform=SplitPairs(),
                generator=self.generator,
            )
            for rule in (self.tc_pairs, self.l_pairs)
        ]

    def __call__(self) -> tuple[TensorDictBase, TensorDictBase]:
        """Pairs of views for the TC-network and for the L-network."""
        tc_pairs, l_pairs = (buffer.sample() for buffer in self.buffers)
        return tc_pairs.to(self.device), l_pairs.to(self.device)


def keep_some(
    pairs: TensorDictBase, limit: int, generator: torch.Generator | None
) -> TensorDictBase:
    """At most ``limit`` pairs ``[P]``, drawn at random; the sum of weights is kept."""
    if len(pairs) <= limit:
        return pairs
    weight = pairs.get(WEIGHT)
    chosen = torch.randperm(len(pairs), generator=generator)[:limit].to(weight.device)
    kept = pairs[chosen]
    share = weight.sum() / weight[chosen].sum()
    return kept.set(WEIGHT, weight[chosen] * share)
