"""`SplitPairs`: from two frames side by side to the keys ``anchor`` and ``other``."""

from tensordict import NestedKey, TensorDictBase
from torchrl.envs.transforms import Transform

from toponav.keys import ANCHOR, NETWORK_PIXELS, OTHER


class SplitPairs(Transform):
    """Turn a sample of pairs, batch ``[P, 2]``, into one of batch ``[P]``.

    For a replay buffer whose `EpisodeSampler` draws `TCPairs` or `LPairs`. The entry
    ``in_key`` of the two frames becomes ``anchor`` and ``other``; of all else, such as
    the action, the anchor's is kept.

    Args:
        in_key: entry of a frame; ``[P, 2, *D]``.

    Raises:
        ValueError: if the sample is not made of pairs.

    Examples:
        >>> import torch
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
                f"{list(tensordict.shape)}; give the buffer EpisodeSampler(TCPairs())."
            )
        (in_key,) = self.in_keys
        first, second = tensordict.unbind(-1)
        pairs = first.exclude(in_key)
        return pairs.update({ANCHOR: first.get(in_key), OTHER: second.get(in_key)})
