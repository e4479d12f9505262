"""`ViewSimilarity`: the callables that compare views, and checks of their answers."""

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

    No module, so that a transform that holds one neither moves nor saves nor trains
    the networks.

    Args:
        embed: views ``[N, H, W, C]`` to embeddings ``[N, D]``.
        compare: embeddings ``[N, D]`` and memory ``[N, M, P]`` to similarities
            ``[N, M]`` in [0, 1].
        prepare: embeddings ``[N, M, D]`` to entries ``[N, M, P]``; ``None`` keeps
            the embeddings.
        embedding_key: named in errors.
        similarity_key: named in errors.

    Examples:
        >>> same = ViewSimilarity(
        ...     embed=lambda views: views.flatten(1),
        ...     compare=lambda one, many: (one.unsqueeze(1) == many).all(-1),
        ... )
        >>> views = torch.tensor([[0.0], [1.0]]).reshape(2, 1, 1, 1)
        >>> memory = same.entries(same.embed(views)).expand(2, 2, 1)
        >>> same.compare(same.embed(views), memory)
        tensor([[1., 0.],
                [0., 1.]])

    Shape notation:
        N: any number of views.  H, W, C: height, width, channels.  D: embedding.
        M: memory.  P: prepared entry.
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
        """Embeddings, float32 ``[N, D]``."""
        return self._embed(views).float()

    def entries(self, embedding: Tensor) -> Tensor:
        """What the memory keeps, ``[N, P]``, of embeddings ``[N, D]``."""
        if self._prepare is None:
            return embedding
        return self._prepare(embedding.unsqueeze(1)).squeeze(1)

    def compare(self, embedding: Tensor, memory: Tensor) -> Tensor:
        """Similarities, float32 ``[N, M]``."""
        return self._compare(embedding, memory).float()

    def check(self, embedding: Tensor, similarity: Tensor | None = None) -> None:
        """Refuse numbers that would silently count as novel; waits for the device.

        Args:
            embedding: ``[N, D]``.
            similarity: ``[N, M]``, if any.

        Raises:
            ValueError: if an embedding or a similarity is NaN or infinite, or a
                similarity is not in [0, 1].
        """
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
        """D, found by trying all callables on the first view of its shape.

        Args:
            view: ``[1, H, W, C]``.

        Raises:
            ValueError: if a callable returns another shape than it must.
        """
        if view.shape in self._lengths:
            return self._lengths[view.shape]
        embedding = self.embed(view)
        if embedding.ndim != 2 or len(embedding) != 1:
            raise ValueError(
                f"embed must return [N, D], got {list(embedding.shape)} for N = 1"
            )
        similarity = self.compare(embedding, self.entries(embedding).unsqueeze(1))
        if similarity.shape != (1, 1):
            raise ValueError(
                f"compare must return [N, M], got {list(similarity.shape)} for N = 1 "
                "and M = 1"
            )
        self._lengths[view.shape] = embedding.shape[-1]
        return embedding.shape[-1]
