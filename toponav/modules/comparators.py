"""`ConcatComparator` and `DifferenceComparator`: closeness in time."""

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812


class Comparator(Protocol):
    """What `TCNetwork` asks of a comparator; both classes of this file provide it."""

    def __call__(self, anchor: Tensor, other: Tensor) -> Tensor:
        """One logit per pair: ``[*B, D]`` and ``[*B, D]`` to ``[*B]``."""

    def prepare(self, memory: Tensor) -> Tensor:
        """What depends on the memory alone: ``[*B, M, D]`` to ``[*B, M, P]``."""

    def compare(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """The rest: ``[*B, D]`` and ``[*B, M, P]`` to logits ``[*B, M]``."""


def _layers(widths: Sequence[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width, next_width in zip(widths, [*widths[1:], 1], strict=True):
        layers += [nn.ReLU(), nn.Linear(width, next_width)]
    return nn.Sequential(*layers)


def _check_hidden(hidden: Sequence[int]) -> None:
    if not hidden or min(hidden) < 1:
        raise ValueError(f"hidden must name at least one width >= 1, got {hidden}.")


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
        _check_hidden(hidden)
        # One weight over the concatenation has the paper's initial scale; its two
        # halves are views.
        self.first = nn.Linear(2 * embedding_dim, hidden[0])
        self.rest = _layers(hidden)

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
        _check_hidden(hidden)
        self.project = nn.Linear(embedding_dim, projection_dim)
        self.first = nn.Linear(2 * projection_dim, hidden[0])
        self.rest = _layers(hidden)

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
