"""`OffsetNetwork`: how far from the waypoints of one map a view is."""

from torch import Tensor

from toponav.modules.scaled_mlp import ScaledMLP


class OffsetNetwork(ScaledMLP):
    """Embeddings of views to how far they were taken from each waypoint of one map.

    A `PlaceNetwork` says which waypoints are near, which are some decisions apart; this
    says where between them the view is. What it says of waypoints that are not near
    means nothing.

    Args:
        num_places: waypoints of the map, W.
        embedding_size: numbers of an embedding, D.
        hidden: width of the layer between.

    Shapes:
        float32 ``[*B, D]`` to ``[*B, W, 3]``: what is added to the pose of a waypoint,
        in steps, steps and degrees.

    Examples:
        >>> import torch
        >>> OffsetNetwork(5, 8)(torch.zeros(2, 3, 8)).shape
        torch.Size([2, 3, 5, 3])
    """

    #: What an output of 1 stands for: steps, steps and degrees.
    UNITS = (1.0, 1.0, 20.0)

    def __init__(
        self, num_places: int, embedding_size: int, *, hidden: int = 256
    ) -> None:
        super().__init__(embedding_size, 3 * num_places, [hidden])
        self.num_places = num_places
        self.embedding_size = embedding_size
        self.hidden = hidden

    def forward(self, inputs: Tensor) -> Tensor:
        """Offsets ``[*B, W, 3]`` of embeddings ``[*B, D]``."""
        outputs: Tensor = super().forward(inputs).unflatten(-1, (-1, 3))
        return outputs * outputs.new_tensor(self.UNITS)
