"""`TCNetwork`: the temporal correlation of two views."""

import torch
from torch import Tensor, nn

from toponav.modules.comparators import Comparator


class TCNetwork(nn.Module):
    """Score how close in time two views are, ``tc = phi_C(phi_E(o_i), phi_E(o_j))``.

    Training calls the network on pairs of views and gets logits. Rewards and maps
    `embed` each view once and `compare` it with a whole memory of embeddings, as
    probabilities in [0, 1]. A memory that many views meet is prepared once
    (`prepare_memory`, then `compare_prepared`). Call ``eval()`` for the latter uses:
    the encoders normalise over the batch. The sigmoid is always taken in float32,
    since thresholds near 1 are below bfloat16's resolution.

    As a TensorDictModule: ``in_keys=["anchor", "other"], out_keys=["logit"]``; on
    ready embeddings wrap ``network.comparator`` with the same keys instead.

    Reference:
        The paper, "Temporal correlation network", eq. 5.

    Args:
        encoder: ``[*B, H, W, 3]`` to ``[*B, D]``; may be shared with other networks.
        comparator: two embeddings to a logit, see `ConcatComparator`.

    Raises:
        ValueError: from ``forward`` and ``embed``, as the encoder raises it.

    Examples:
        >>> from toponav.modules import ConcatComparator, SmallEncoder
        >>> network = TCNetwork(SmallEncoder(64), ConcatComparator(64)).eval()
        >>> views = torch.zeros(3, 120, 160, 3, dtype=torch.uint8)
        >>> network(views, views).shape
        torch.Size([3])
        >>> embedding = network.embed(views)
        >>> network.compare(embedding, embedding.expand(3, 3, 64)).shape
        torch.Size([3, 3])

    Shape notation:
        B: any batch dimensions.  M: memory.  D: embedding.
    """

    def __init__(self, encoder: nn.Module, comparator: Comparator) -> None:
        super().__init__()
        self.encoder = encoder
        self.comparator = comparator

    def forward(self, anchor: Tensor, other: Tensor) -> Tensor:
        """Logits of pairs of views: twice ``[*B, H, W, 3]`` to ``[*B]``."""
        # One call of the encoder: batch normalisation then sees both sides at once.
        embedding_anchor, embedding_other = self.embed(torch.stack([anchor, other]))
        return self.comparator(embedding_anchor, embedding_other)

    def embed(self, pixels: Tensor) -> Tensor:
        """Embed views: ``[*B, H, W, 3]`` to ``[*B, D]``."""
        embedding: Tensor = self.encoder(pixels)
        return embedding

    def compare(self, embedding: Tensor, memory: Tensor) -> Tensor:
        """Temporal correlation with every entry of a memory.

        Args:
            embedding: ``[*B, D]``.
            memory: ``[*B, M, D]``.

        Returns:
            Probabilities ``[*B, M]``, float32.
        """
        return self.compare_prepared(embedding, self.prepare_memory(memory))

    def prepare_memory(self, memory: Tensor) -> Tensor:
        """What of a comparison depends on the memory alone, to be kept.

        Args:
            memory: ``[*B, M, D]``.

        Returns:
            ``[*B, M, P]``. Valid until the comparator's weights change.
        """
        return self.comparator.prepare(memory)

    def compare_prepared(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """`compare` with a memory from `prepare_memory`.

        Args:
            embedding: ``[*B, D]``.
            prepared: ``[*B, M, P]``.

        Returns:
            Probabilities ``[*B, M]``, float32.
        """
        return self.comparator.compare(embedding, prepared).float().sigmoid()
