"""`MinedPairs` and `DrawnPairs`: the two ways from a storage to training pairs."""

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import ReplayBuffer, TensorDictReplayBuffer
from torchrl.data.replay_buffers import Storage

from toponav.data.chunks import Chunks
from toponav.data.episode_sampler import DrawRule, EpisodeSampler
from toponav.data.l_pairs import LPairs
from toponav.data.split_pairs import SplitPairs
from toponav.data.tc_pairs import TCPairs
from toponav.keys import EMBEDDING, LABEL, PIXELS, TRAJECTORY, WEIGHT

#: Views ``[N, H, W, 3]`` to embeddings ``[N, D]``.
Embed = Callable[[Tensor], Tensor]


class MinedPairs:
    """Many pairs from few views: embed some chunks of frames, then pair all of them.

    A call draws a batch of `Chunks`, embeds each view once and returns pairs *of
    embeddings* for the TC-network and for the L-network, with gradients to the
    encoders. Of the close and of the distant pairs at most half of ``max_pairs`` each
    are kept, drawn at random, so that the number does not hang on k.

    Args:
        storage: frames with ``pixels``, ``action``, an episode number and a step.
        chunks: the shape of a batch.
        num_frames: frames in a batch, a multiple of a chunk group's.
        tc_pairs: the TC-network's rule.
        l_pairs: the L-network's rule.
        embed_tc: the TC-network's encoder.
        embed_l: the L-network's, ``None`` if both share one.
        max_pairs: most pairs of a call for each network.
        generator: source of the random numbers, torch's own by default.
        device: where the frames go before they are embedded.

    Raises:
        ValueError: if ``max_pairs < 2``; from a call, as `Chunks` raises it.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage
        >>> storage = LazyTensorStorage(90)
        >>> step = torch.arange(90)
        >>> frames = {"pixels": torch.zeros(90, 2, 2, 3), "action": step % 6}
        >>> frames |= {"step_count": step, "collector": {"traj_ids": step // 45}}
        >>> _ = storage.set(slice(0, 90), TensorDict(frames, [90]))
        >>> rules = {"tc_pairs": TCPairs(), "l_pairs": LPairs()}
        >>> pairs = MinedPairs(
        ...     storage, Chunks(), 40, **rules, embed_tc=lambda x: x.flatten(1)
        ... )
        >>> tc_pairs, l_pairs = pairs()
        >>> sorted(tc_pairs.keys()), tc_pairs["anchor"].shape[1:]
        (['anchor', 'label', 'other', 'weight'], torch.Size([12]))

    Shape notation:
        N: frames of a batch.  D: embedding.
    """

    def __init__(
        self,
        storage: Storage,
        chunks: Chunks,
        num_frames: int,
        *,
        tc_pairs: TCPairs,
        l_pairs: LPairs,
        embed_tc: Embed,
        embed_l: Embed | None = None,
        max_pairs: int = 2048,
        generator: torch.Generator | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        if max_pairs < 2:
            raise ValueError(f"max_pairs must be at least 2, got {max_pairs}.")
        self.frames = _make_buffer(storage, chunks, num_frames, generator)
        self.tc_pairs = tc_pairs
        self.l_pairs = l_pairs
        self.embed_tc = embed_tc
        self.embed_l = embed_l
        self.max_pairs = max_pairs
        self.generator = generator
        self.device = device

    def __call__(self) -> tuple[TensorDictBase, TensorDictBase]:
        """Pairs of embeddings for the TC-network and for the L-network."""
        frames = self.frames.sample().flatten()
        views = frames.pop(PIXELS).to(self.device)
        frames.set(EMBEDDING, self.embed_tc(views))
        tc_pairs = self.tc_pairs.mine(frames, generator=self.generator)
        half = self.max_pairs // 2
        tc_pairs = torch.cat(
            [
                keep_some(tc_pairs[tc_pairs[LABEL] == label], half, self.generator)
                for label in (1, 0)
            ]
        )
        if self.embed_l is not None:
            frames.set(EMBEDDING, self.embed_l(views))
        l_pairs = self.l_pairs.mine(frames)
        return tc_pairs, keep_some(l_pairs, self.max_pairs, self.generator)


class DrawnPairs:
    """Pairs one by one, the paper's way: every pair brings two views of its own.

    A call returns pairs *of views* for the TC-network and for the L-network.

    Args:
        storage: frames with ``pixels``, ``action``, an episode number and a step.
        num_pairs: pairs of a call for each network.
        tc_pairs: the TC-network's rule.
        l_pairs: the L-network's rule.
        generator: source of the random numbers, torch's own by default.
        device: where the pairs go.

    Raises:
        ValueError: from a call, if no episode is long enough for a rule.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage
        >>> storage = LazyTensorStorage(90)
        >>> step = torch.arange(90)
        >>> frames = {"pixels": torch.zeros(90, 2, 2, 3), "action": step % 6}
        >>> frames |= {"step_count": step, "collector": {"traj_ids": step // 45}}
        >>> _ = storage.set(slice(0, 90), TensorDict(frames, [90]))
        >>> pairs = DrawnPairs(storage, 64, tc_pairs=TCPairs(), l_pairs=LPairs())
        >>> tc_pairs, l_pairs = pairs()
        >>> tc_pairs["anchor"].shape
        torch.Size([64, 2, 2, 3])
    """

    def __init__(
        self,
        storage: Storage,
        num_pairs: int,
        *,
        tc_pairs: TCPairs,
        l_pairs: LPairs,
        generator: torch.Generator | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self.buffers = [
            _make_buffer(storage, rule, num_pairs, generator)
            for rule in (tc_pairs, l_pairs)
        ]
        for buffer in self.buffers:
            buffer.append_transform(SplitPairs())
        self.device = device

    def __call__(self) -> tuple[TensorDictBase, TensorDictBase]:
        """Pairs of views for the TC-network and for the L-network."""
        tc_pairs, l_pairs = (buffer.sample() for buffer in self.buffers)
        return tc_pairs.to(self.device), l_pairs.to(self.device)


def keep_some(
    pairs: TensorDictBase, limit: int, generator: torch.Generator | None
) -> TensorDictBase:
    """At most ``limit`` pairs, drawn without replacement; the sum of weights stays.

    Args:
        pairs: ``[P]`` with ``weight``.
        limit: number of pairs to keep.
        generator: source of the random numbers; on the CPU.

    Examples:
        >>> from tensordict import TensorDict
        >>> pairs = TensorDict({"weight": torch.full((4,), 0.25)}, [4])
        >>> keep_some(pairs, 2, None)["weight"]
        tensor([0.5000, 0.5000])
    """
    if len(pairs) <= limit:
        return pairs
    weight = pairs.get(WEIGHT)
    chosen = torch.randperm(len(pairs), generator=generator)[:limit].to(weight.device)
    kept = pairs[chosen]
    share = weight.sum() / weight[chosen].sum()
    return kept.set(WEIGHT, weight[chosen] * share)


def _make_buffer(
    storage: Storage,
    rule: DrawRule,
    batch_size: int,
    generator: torch.Generator | None,
) -> ReplayBuffer:
    """A reader of the storage; whoever writes to the storage tells it."""
    buffer = TensorDictReplayBuffer(
        storage=storage,
        sampler=EpisodeSampler(rule, trajectory_key=TRAJECTORY),
        batch_size=batch_size,
    )
    buffer.set_rng(generator)
    return buffer
