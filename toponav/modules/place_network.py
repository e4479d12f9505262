"""`PlaceNetwork`: at which waypoint of one map a view is."""

from toponav.modules.scaled_mlp import ScaledMLP


class PlaceNetwork(ScaledMLP):
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
        >>> import torch
        >>> PlaceNetwork(5, 8)(torch.zeros(2, 3, 8)).shape
        torch.Size([2, 3, 5])
    """

    def __init__(
        self, num_places: int, embedding_size: int, *, hidden: int = 512
    ) -> None:
        super().__init__(embedding_size, num_places, [hidden])
        self.num_places = num_places
        self.embedding_size = embedding_size
        self.hidden = hidden
