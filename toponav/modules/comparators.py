"""`ConcatComparator` and `DifferenceComparator`: closeness in time."""

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.modules import MLP


class Comparator(Protocol):
    """What `TCNetwork` asks of a comparator; both classes of this file provide it."""

    def __call__(self, anchor: Tensor, other: Tensor) -> Tensor:
        """One logit per pair: ``[*B, D]`` and ``[*B, D]`` to ``[*B]``."""

    def prepare(self, memory: Tensor) -> Tensor:
        """What depends on the memory alone: ``[*B, M, D]`` to ``[*B, M, P]``."""

    def compare(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """The rest: ``[*B, D]`` and ``[*B, M, P]`` to logits ``[*B, M]``."""


def _layers(inputs: int, hidden: Sequence[int]) -> tuple[nn.Linear, nn.Sequential]:
    """A perceptron with one output: its first layer, and the others."""
    if not hidden or min(hidden) < 1:
        raise ValueError(f"hidden must name at least one width >= 1, got {hidden}.")
    first, *rest = MLP(inputs, 1, num_cells=hidden, activation_class=nn.ReLU)
    return first, nn.Sequential(*rest)


class ConcatComparator(nn.Module):
    """Compare two embeddings by a perceptron on their concatenation, as in the paper.

    The first layer is split, so that a memory's half is computed once. Not symmetric;
    training swaps pairs at random.

    Reference:
        The paper, phi_C of eq. 5: four hidden layers of 512 with ReLU.

    Args:
        embedding_dim: length D of the embeddings.
        hidden: widths of the hidden layers, at least one, each at least 1.
    """

    def __init__(
        self, embedding_dim: int, *, hidden: Sequence[int] = (512, 512, 512, 512)
    ) -> None:
        super().__init__()
        # One weight over the concatenation has the paper's initial scale; its two
        # halves are views.
        self.first, self.rest = _layers(2 * embedding_dim, hidden)

    def forward(self, anchor: Tensor, other: Tensor) -> Tensor:
        logit: Tensor = self.rest(self.first(torch.cat([anchor, other], dim=-1)))
        return logit.squeeze(-1)

    def prepare(self, memory: Tensor) -> Tensor:
        _, half = self.first.weight.chunk(2, dim=1)
        return F.linear(memory, half, self.first.bias)

    def compare(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        half, _ = self.first.weight.chunk(2, dim=1)
        first = F.linear(embedding, half).unsqueeze(-2) + prepared
        logit: Tensor = self.rest(first)
        return logit.squeeze(-1)


class DifferenceComparator(nn.Module):
    """Compare embeddings symmetrically, ``f([|Pa - Pb|; Pa * Pb])`` of projections P.

    Args:
        embedding_dim: length D of the embeddings.
        projection_dim: length of the projections.
        hidden: widths of the hidden layers, at least one, each at least 1.

    Examples:
        >>> comparator = DifferenceComparator(8, projection_dim=4, hidden=(16,))
        >>> a, b = torch.randn(2, 5, 8)
        >>> torch.equal(comparator(a, b), comparator(b, a))
        True
    """

    def __init__(
        self,
        embedding_dim: int,
        *,
        projection_dim: int = 128,
        hidden: Sequence[int] = (256,),
    ) -> None:
        super().__init__()
        self.project = nn.Linear(embedding_dim, projection_dim)
        self.first, self.rest = _layers(2 * projection_dim, hidden)

    def forward(self, anchor: Tensor, other: Tensor) -> Tensor:
        return self._score(self.project(anchor), self.project(other))

    def prepare(self, memory: Tensor) -> Tensor:
        projection: Tensor = self.project(memory)
        return projection

    def compare(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        return self._score(self.project(embedding).unsqueeze(-2), prepared)

    def _score(self, anchor: Tensor, other: Tensor) -> Tensor:
        features = torch.cat([(anchor - other).abs(), anchor * other], dim=-1)
        logit: Tensor = self.rest(self.first(features))
        return logit.squeeze(-1)
