"""`GroundNetwork`: where a view says that the ground before the agent is free."""

from torch import Tensor

from toponav.modules.scaled_mlp import ScaledMLP


class GroundNetwork(ScaledMLP):
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
        >>> import torch
        >>> GroundNetwork(8, 13, 12)(torch.zeros(2, 8)).shape
        torch.Size([2, 13, 12])
    """

    def __init__(
        self,
        embedding_size: int,
        num_bearings: int,
        num_distances: int,
        *,
        hidden: int = 256,
    ) -> None:
        num_spots = num_bearings * num_distances
        super().__init__(embedding_size, num_spots, [hidden, hidden])
        self.embedding_size, self.hidden = embedding_size, hidden
        self.num_bearings, self.num_distances = num_bearings, num_distances

    def forward(self, inputs: Tensor) -> Tensor:
        """Logits of the spots ``[*B, K, R]`` of embeddings ``[*B, D]``."""
        shape = self.num_bearings, self.num_distances
        logits: Tensor = super().forward(inputs).unflatten(-1, shape)
        return logits
