"""`SplitPairs`: from two frames side by side to the keys ``anchor`` and ``other``."""

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torchrl.envs.transforms import Transform

from toponav.keys import ANCHOR, OTHER, PIXELS


class SplitPairs(Transform):
    """Turn a sample of pairs, batch ``[P, 2]``, into one of batch ``[P]``.

    For a replay buffer whose `EpisodeSampler` draws `TCPairs` or `LPairs`. The entry
    ``in_key`` of the two frames becomes ``anchor`` and ``other``; of all else, such as
    the action, the anchor's is kept.

    Args:
        in_key: entry of a frame; ``[P, 2, *D]``.
        out_keys: keys of the first and the second frame's entry; ``[P, *D]``.

    Raises:
        ValueError: if the sample is not made of pairs.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> from toponav.data import EpisodeSampler, TCPairs
        >>> buffer = TensorDictReplayBuffer(
        ...     storage=LazyTensorStorage(100),
        ...     sampler=EpisodeSampler(TCPairs()),
        ...     transform=SplitPairs(),
        ...     batch_size=64,
        ... )
        >>> done = torch.zeros(60, 1, dtype=torch.bool)
        >>> pixels = torch.zeros(60, 6, 8, 3, dtype=torch.uint8)
        >>> frames = {"pixels": pixels, "next": {"done": done}}
        >>> _ = buffer.extend(TensorDict(frames, [60]))
        >>> pairs = buffer.sample()
        >>> pairs["anchor"].shape, pairs["label"].shape
        (torch.Size([64, 6, 8, 3]), torch.Size([64]))

    Shape notation:
        P: pairs.
    """

    def __init__(
        self,
        in_key: NestedKey = PIXELS,
        *,
        out_keys: Sequence[NestedKey] = (ANCHOR, OTHER),
    ) -> None:
        super().__init__(in_keys=[in_key], out_keys=list(out_keys))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if tensordict.ndim < 2 or tensordict.shape[-1] != 2:
            raise ValueError(
                f"the sample must be of pairs, batch size [P, 2], got "
                f"{list(tensordict.shape)}; give the buffer EpisodeSampler(TCPairs())."
            )
        first, second = tensordict.unbind(-1)
        anchor_key, other_key = self.out_keys
        (in_key,) = self.in_keys
        pairs = first.exclude(in_key)
        pairs.set(anchor_key, first.get(in_key))
        pairs.set(other_key, second.get(in_key))
        return pairs
