"""`EmbedViews`: embeddings for policies and maps where no reward needs them."""

from functools import partial

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from toponav.keys import EMBEDDING, NETWORK_PIXELS
from toponav.transforms.specs import Keys, ViewTransform
from toponav.transforms.view_similarity import Embed, embedding_length


class EmbedViews(ViewTransform):
    """Writes the embedding of each view, without gradient, as `WaypointMemory` does.

    The network is a callable in ``eval()`` mode, neither moved nor saved with the
    transform; its new weights count from the next decision on.

    Args:
        embed: views ``[N, H, W, C]`` to embeddings ``[N, D]``.
        in_keys: keys of the views, ``[*B, H, W, C]``, ``network_pixels`` unless given.
        out_keys: keys of the embeddings, float32 ``[*B, D]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> mean = EmbedViews(lambda views: views.float().mean((1, 2)))
        >>> views = torch.full((2, 4, 6, 3), 5, dtype=torch.uint8)
        >>> mean(TensorDict({"network_pixels": views}, [2]))["embedding"][0]
        tensor([5., 5., 5.])
    """

    def __init__(
        self, embed: Embed, *, in_keys: Keys = None, out_keys: Keys = None
    ) -> None:
        super().__init__(in_keys or [NETWORK_PIXELS], out_keys or [EMBEDDING])
        # Inside a partial, a network is not registered as a part of this module.
        self._embed = partial(embed)

    @torch.no_grad()
    def _apply_transform(self, obs: Tensor) -> Tensor:
        embedding = self._embed(obs.reshape(-1, *obs.shape[-3:])).float()
        return embedding.reshape(*obs.shape[:-3], -1)

    def _spec_of(self, key: NestedKey, view: TensorSpec) -> TensorSpec:
        shape = (*view.shape[:-3], embedding_length(self._embed, view))
        return Unbounded(shape, view.device, torch.float32)
