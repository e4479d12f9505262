"""`SteeringNetwork`: what practice adds to steering by poses."""

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

#: Width of the two layers between.
_HIDDEN = 128


class SteeringNetwork(nn.Module):
    """Corrects what steering in free space says of each action, by view and senses.

    It begins with no correction at all, so that an agent that has not practised yet
    steers as before.

    Args:
        embedding_size: numbers of a view's embedding, D.
        senses_size: numbers of what a navigator senses beside it, S (`SteeringSenses`).
        num_actions: A.

    Shapes:
        float32 ``[*B, D]``, ``[*B, S]`` and the logits of free space ``[*B, A]`` to
        logits ``[*B, A]``.

    Examples:
        >>> network = SteeringNetwork(8, 3, 2)
        >>> free = torch.tensor([[-1.0, -2.0]])
        >>> network(torch.zeros(1, 8), torch.zeros(1, 3), free).tolist()
        [[-1.0, -2.0]]
    """

    def __init__(self, embedding_size: int, senses_size: int, num_actions: int) -> None:
        super().__init__()
        #: What another must have, too, to take its weights.
        self.sizes = {
            "embedding_size": embedding_size,
            "senses_size": senses_size,
            "num_actions": num_actions,
            "hidden": _HIDDEN,
        }
        self.norm = nn.LayerNorm(embedding_size)
        given = embedding_size + senses_size
        self.layers = _layers(given, num_actions)
        self.layers[-1].weight.data.zero_()
        self.layers[-1].bias.data.zero_()

    def forward(self, embedding: Tensor, senses: Tensor, free: Tensor) -> Tensor:
        given = torch.cat([self.norm(embedding), senses], -1)
        logits: Tensor = free + self.layers(given)
        return logits


class SteeringValue(nn.Module):
    """How much progress is to come, by the same view and senses; for practice alone.

    Shapes:
        float32 ``[*B, D]`` and ``[*B, S]`` to ``[*B, 1]``.

    Examples:
        >>> SteeringValue(8, 3)(torch.zeros(2, 8), torch.zeros(2, 3)).shape
        torch.Size([2, 1])
    """

    def __init__(self, embedding_size: int, senses_size: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(embedding_size)
        self.layers = _layers(embedding_size + senses_size, 1)

    def forward(self, embedding: Tensor, senses: Tensor) -> Tensor:
        value: Tensor = self.layers(torch.cat([self.norm(embedding), senses], -1))
        return value


def _layers(given: int, found: int) -> MLP:
    return MLP(given, found, num_cells=[_HIDDEN, _HIDDEN], activation_class=nn.Tanh)
