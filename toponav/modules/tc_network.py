"""`TCNetwork`: the temporal correlation of two views."""

import torch
from torch import Tensor, nn

from toponav.modules.comparators import Comparator


class TCNetwork(nn.Module):
    """Score how close in time two views are, ``tc = phi_C(phi_E(o_i), phi_E(o_j))``.

    Training calls the network on pairs of views and gets logits. Rewards and maps
    `embed` each view once and `compare` it with a memory of embeddings, as
    probabilities, after ``eval()``; a memory that many views meet is prepared once.

    Reference:
        The paper, "Temporal correlation network", eq. 5.

    Args:
        encoder: ``[*B, H, W, 3]`` to ``[*B, D]``; may be shared with other networks.
        comparator: two embeddings to a logit, see `ConcatComparator`.

    Examples:
        >>> from toponav.modules import ConcatComparator, SmallEncoder
        >>> encoder = SmallEncoder(64, image_size=(24, 32))
        >>> network = TCNetwork(encoder, ConcatComparator(64)).eval()
        >>> views = torch.zeros(3, 24, 32, 3, dtype=torch.uint8)
        >>> embedding = network.embed(views)
        >>> network.compare(embedding, embedding.expand(3, 3, 64)).shape
        torch.Size([3, 3])
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
        embedding: Tensor = self.encoder(pixels)
        return embedding

    def compare(self, embedding: Tensor, memory: Tensor) -> Tensor:
        """Probabilities: ``[*B, D]``, memory ``[*B, M, D]`` to float32 ``[*B, M]``."""
        return self.compare_prepared(embedding, self.prepare_memory(memory))

    def prepare_memory(self, memory: Tensor) -> Tensor:
        """``[*B, M, D]`` to ``[*B, M, P]``, valid until the comparator changes."""
        return self.comparator.prepare(memory)

    def compare_prepared(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """`compare` with a memory from `prepare_memory`."""
        # Thresholds near 1 are below bfloat16's resolution.
        return self.comparator.compare(embedding, prepared).float().sigmoid()
