"""`GroundNetwork`: where a view says that the ground before the agent is free."""

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

_DROPOUT = 0.1


class GroundNetwork(nn.Module):
    """Embeddings of views to the chance that each of K x R spots ahead is free.

    A TC-network compares views and a `PlaceNetwork` names places; neither says where
    the walls are that an agent stands before.

    Args:
        embedding_size: numbers of an embedding, D.
        num_bearings: K.
        num_distances: R.
        hidden: width of the two layers between.

    Shapes:
        float32 ``[*B, D]`` to logits ``[*B, K, R]``.

    Examples:
        >>> GroundNetwork(8, 13, 12)(torch.zeros(2, 8)).shape
        torch.Size([2, 13, 12])
    """

    mean: Tensor
    spread: Tensor

    def __init__(
        self,
        embedding_size: int,
        num_bearings: int,
        num_distances: int,
        *,
        hidden: int = 256,
    ) -> None:
        super().__init__()
        self.embedding_size, self.hidden = embedding_size, hidden
        self.num_bearings, self.num_distances = num_bearings, num_distances
        self.register_buffer("mean", torch.zeros(embedding_size))
        self.register_buffer("spread", torch.ones(embedding_size))
        self.layers = MLP(
            embedding_size,
            num_bearings * num_distances,
            num_cells=[hidden, hidden],
            activation_class=nn.ReLU,
            dropout=_DROPOUT,
        )

    def scale_by(self, embeddings: Tensor) -> None:
        """Take mean and deviation of the inputs from embeddings ``[V, D]``."""
        self.mean.copy_(embeddings.mean(0))
        self.spread.copy_(embeddings.std(0) + 1e-3)

    def forward(self, embedding: Tensor) -> Tensor:
        logits = self.layers((embedding - self.mean) / self.spread)
        spots: Tensor = logits.unflatten(-1, (self.num_bearings, self.num_distances))
        return spots
