"""`EmbedViews` and `ViewSimilarity`: embeddings and similarities by given callables."""

from collections.abc import Callable
from functools import partial

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from toponav.keys import EMBEDDING, NETWORK_PIXELS
from toponav.parts import require_callables, require_returned
from toponav.transforms.specs import Keys, ViewTransform
from toponav.views import ChannelOrder, check_views

Embed = Callable[[Tensor], Tensor]
Compare = Callable[[Tensor, Tensor], Tensor]

#: What rounding may add to a similarity of 0 or 1.
_ROUNDING = 1e-3


class EmbedViews(ViewTransform):
    """Writes the embedding of each view, without gradient, as `WaypointMemory` does.

    The network is a callable in ``eval()`` mode, neither moved nor saved with it.

    Args:
        embed: views ``[N, H, W, C]``, as they are, to embeddings ``[N, D]``.
        in_keys: keys of the views, ``network_pixels`` unless given, see ``channels``.
        out_keys: keys of the embeddings, float32 ``[*B, D]``.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, C, H, W]``.

    Examples:
        >>> mean = EmbedViews(lambda views: views.float().mean((1, 2)))
        >>> views = torch.full((2, 4, 6, 3), 5, dtype=torch.uint8)
        >>> mean(TensorDict({"network_pixels": views}, [2]))["embedding"][0]
        tensor([5., 5., 5.])
    """

    def __init__(
        self,
        embed: Embed,
        *,
        in_keys: Keys = None,
        out_keys: Keys = None,
        channels: ChannelOrder = "HWC",
    ) -> None:
        in_keys, out_keys = in_keys or [NETWORK_PIXELS], out_keys or [EMBEDDING]
        super().__init__(in_keys, out_keys, channels=channels)
        require_callables(embed=embed)
        # Inside a partial, a network is not registered as a part of this module.
        self._embed = partial(embed)

    @torch.no_grad()
    def _apply_transform(self, obs: Tensor) -> Tensor:
        check_views("views", obs.shape, self.channels)
        embedding = self._embed(obs.reshape(-1, *obs.shape[-3:])).float()
        return embedding.reshape(*obs.shape[:-3], -1)

    def _spec_of(self, key: NestedKey, view: TensorSpec) -> TensorSpec:
        length = embed_one(self._embed, view).shape[-1]
        return Unbounded((*view.shape[:-3], length), view.device, torch.float32)


class ViewSimilarity:
    """How `WaypointMemory` compares views; no module, so that it moves no network."""

    def __init__(
        self, embed: Embed, compare: Compare, prepare: Embed | None = None
    ) -> None:
        require_callables(embed=embed, compare=compare, prepare=prepare)
        self._embed = embed
        self._compare = compare
        self._prepare = prepare
        self._lengths: dict[torch.Size, int] = {}

    def embed(self, views: Tensor) -> Tensor:
        """Embeddings of views ``[N, ...]``, float32 ``[N, D]``."""
        return self._embed(views).float()

    def entries(self, embedding: Tensor) -> Tensor:
        """What a memory keeps of embeddings ``[N, D]``, ``[N, P]``, to compare with."""
        if self._prepare is None:
            return embedding
        return self._prepare(embedding.unsqueeze(1)).squeeze(1)

    def compare(self, embedding: Tensor, memory: Tensor) -> Tensor:
        """Similarities of embeddings ``[N, D]`` to M entries each, ``[N, M]``."""
        return self._compare(embedding, memory).float()

    def check(self, embedding: Tensor, similarity: Tensor | None = None) -> None:
        """Raise ValueError for numbers that would silently count as novel."""
        # A sum is not finite if any of its numbers is not.
        if not bool(embedding.sum().isfinite()):
            broken = int((~embedding.isfinite()).any(-1).sum())
            got = f"NaN or infinity for {broken} of {len(embedding)} views"
            raise ValueError(f"embed must return finite numbers, got {got}")
        if similarity is None:
            return
        low, high = (float(end) for end in similarity.aminmax())
        # A comparison with NaN is false.
        if not (low >= -_ROUNDING and high <= 1 + _ROUNDING):
            got = f"{low:.3g} to {high:.3g}"
            raise ValueError(f"compare must return similarities in [0, 1], got {got}")

    @torch.no_grad()
    def embedding_length(self, views: TensorSpec) -> int:
        """D, and ValueError if a callable returns a wrong shape for one view."""
        if views.shape not in self._lengths:
            embedding = embed_one(self.embed, views)
            similarity = self.compare(embedding, self.entries(embedding).unsqueeze(1))
            require_returned("compare", similarity, N=1, M=1)
            self._lengths[views.shape] = embedding.shape[-1]
        return self._lengths[views.shape]


@torch.no_grad()
def embed_one(embed: Embed, views: TensorSpec) -> Tensor:
    """The embedding ``[1, D]`` of a black view; ValueError if it has another shape."""
    embedding = embed(views.zero().reshape(-1, *views.shape[-3:])[:1])
    require_returned("embed", embedding, N=1, D=None)
    return embedding
