"""`ViewSimilarity`: callables that compare views, and checks of their results."""

from collections.abc import Callable

import torch
from tensordict import NestedKey
from torch import Tensor

from toponav.keys import EMBEDDING, SIMILARITY

Embed = Callable[[Tensor], Tensor]
Compare = Callable[[Tensor, Tensor], Tensor]

#: What rounding may add to a similarity of 0 or 1.
_ROUNDING = 1e-3


class ViewSimilarity:
    """How `WaypointMemory` compares views; the networks behind it are not its own.

    Not a module, so that a transform that holds one neither moves nor saves nor trains
    the networks. The arguments are those of `WaypointMemory`; keys are named in errors.
    """

    def __init__(
        self,
        embed: Embed,
        compare: Compare,
        prepare: Embed | None = None,
        *,
        embedding_key: NestedKey = EMBEDDING,
        similarity_key: NestedKey = SIMILARITY,
    ) -> None:
        self._embed = embed
        self._compare = compare
        self._prepare = prepare
        self.embedding_key = embedding_key
        self.similarity_key = similarity_key
        self._lengths: dict[torch.Size, int] = {}

    def embed(self, views: Tensor) -> Tensor:
        return self._embed(views).float()

    def entries(self, embedding: Tensor) -> Tensor:
        if self._prepare is None:
            return embedding
        return self._prepare(embedding.unsqueeze(1)).squeeze(1)

    def compare(self, embedding: Tensor, memory: Tensor) -> Tensor:
        return self._compare(embedding, memory).float()

    def check(self, embedding: Tensor, similarity: Tensor | None = None) -> None:
        """Raise ValueError for numbers that would silently count as novel."""
        # A sum is not finite if any of its numbers is not.
        if not bool(embedding.sum().isfinite()):
            broken = int((~embedding.isfinite()).any(-1).sum())
            raise ValueError(
                f"{self.embedding_key!r} must be finite, got NaN or infinity from "
                f"embed() for {broken} of {len(embedding)} views"
            )
        if similarity is None:
            return
        low, high = (float(end) for end in similarity.aminmax())
        # A comparison with NaN is false.
        if not (low >= -_ROUNDING and high <= 1 + _ROUNDING):
            raise ValueError(
                f"{self.similarity_key!r} must be in [0, 1], got {low:.3g} to "
                f"{high:.3g} from compare()"
            )

    @torch.no_grad()
    def embedding_length(self, view: Tensor) -> int:
        """D, and ValueError if a callable returns a wrong shape for one view."""
        if view.shape in self._lengths:
            return self._lengths[view.shape]
        length = embedding_length(self._embed, view)
        embedding = self.embed(view)
        similarity = self.compare(embedding, self.entries(embedding).unsqueeze(1))
        if similarity.shape != (1, 1):
            raise ValueError(
                f"compare must return [N, M], got {list(similarity.shape)} for N = 1 "
                "and M = 1"
            )
        self._lengths[view.shape] = length
        return length


@torch.no_grad()
def embedding_length(embed: Embed, view: Tensor) -> int:
    """D, and ValueError if ``embed`` returns a wrong shape for one view."""
    embedding = embed(view)
    if embedding.ndim != 2 or len(embedding) != 1:
        raise ValueError(
            f"embed must return [N, D], got {list(embedding.shape)} for N = 1"
        )
    return embedding.shape[-1]
