"""`PlaceNetwork`: at which waypoint of one map a view is."""

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

_DROPOUT = 0.1


class PlaceNetwork(nn.Module):
    """Embeddings of views to logits of the waypoints of one map.

    It answers for all waypoints at once, by one look at the view, where a TC-network
    compares the view with each: so it can learn what tells places apart that look
    alike.

    Args:
        num_places: waypoints of the map, W.
        embedding_size: numbers of an embedding, D.
        hidden: width of the layer between.

    Shapes:
        float32 ``[*B, D]`` to ``[*B, W]``.

    Examples:
        >>> PlaceNetwork(5, 8)(torch.zeros(2, 3, 8)).shape
        torch.Size([2, 3, 5])
    """

    mean: Tensor
    spread: Tensor

    def __init__(
        self, num_places: int, embedding_size: int, *, hidden: int = 512
    ) -> None:
        super().__init__()
        self.num_places = num_places
        self.embedding_size = embedding_size
        self.hidden = hidden
        self.register_buffer("mean", torch.zeros(embedding_size))
        self.register_buffer("spread", torch.ones(embedding_size))
        self.layers = MLP(
            embedding_size,
            num_places,
            num_cells=[hidden],
            activation_class=nn.ReLU,
            dropout=_DROPOUT,
        )

    def scale_by(self, embeddings: Tensor) -> None:
        """Take mean and deviation of the inputs from embeddings ``[V, D]``."""
        self.mean.copy_(embeddings.mean(0))
        self.spread.copy_(embeddings.std(0) + 1e-3)

    def forward(self, embedding: Tensor) -> Tensor:
        logits: Tensor = self.layers((embedding - self.mean) / self.spread)
        return logits
