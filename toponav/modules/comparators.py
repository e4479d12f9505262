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
        """The memory's half of the work: ``[*B, M, D]`` to ``[*B, M, P]``."""

    def compare(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """The rest: ``[*B, D]`` and ``[*B, M, P]`` to logits ``[*B, M]``."""


def _layers(widths: Sequence[int]) -> nn.Sequential:
    """Linear layers with a ReLU before each, ending in one logit."""
    layers: list[nn.Module] = []
    for width, next_width in zip(widths, [*widths[1:], 1], strict=True):
        layers += [nn.ReLU(), nn.Linear(width, next_width)]
    return nn.Sequential(*layers)


def _check_hidden(hidden: Sequence[int]) -> None:
    if not hidden or min(hidden) < 1:
        raise ValueError(f"hidden must name at least one width >= 1, got {hidden}.")


class ConcatComparator(nn.Module):
    """Compare two embeddings by a perceptron on their concatenation, as in the paper.

    The first layer is split, ``W [a; b] + c = Wa a + (Wb b + c)``, which is exact and
    lets a memory's half be computed once: 1.57 instead of 2.62 MFLOP per pair at 512
    wide. Not symmetric by construction; training swaps pairs at random.

    Reference:
        The paper, phi_C of eq. 5: four hidden layers of 512 with ReLU.

    Args:
        embedding_dim: length D of the embeddings.
        hidden: widths of the hidden layers.

    Raises:
        ValueError: if ``hidden`` is empty or holds a width below 1.

    Examples:
        >>> comparator = ConcatComparator(8, hidden=(16, 16))
        >>> comparator(torch.zeros(5, 8), torch.zeros(5, 8)).shape
        torch.Size([5])
        >>> prepared = comparator.prepare(torch.zeros(2, 30, 8))
        >>> comparator.compare(torch.zeros(2, 8), prepared).shape
        torch.Size([2, 30])

    Shape notation:
        B: any batch dimensions.  M: memory.  D: embedding.
    """

    def __init__(
        self, embedding_dim: int, *, hidden: Sequence[int] = (512, 512, 512, 512)
    ) -> None:
        super().__init__()
        _check_hidden(hidden)
        # One weight over the concatenation, so that the initial scale is the
        # paper's; its two halves are views.
        self.first = nn.Linear(2 * embedding_dim, hidden[0])
        self.rest = _layers(hidden)

    def forward(self, anchor: Tensor, other: Tensor) -> Tensor:
        """One logit per pair: ``[*B, D]`` and ``[*B, D]`` to ``[*B]``."""
        logit: Tensor = self.rest(self.first(torch.cat([anchor, other], dim=-1)))
        return logit.squeeze(-1)

    def prepare(self, memory: Tensor) -> Tensor:
        """The memory's half of the first layer: ``[*B, M, D]`` to ``[*B, M, P]``."""
        _, half = self.first.weight.chunk(2, dim=1)
        return F.linear(memory, half, self.first.bias)

    def compare(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """The rest: ``[*B, D]`` and ``[*B, M, P]`` to logits ``[*B, M]``."""
        half, _ = self.first.weight.chunk(2, dim=1)
        first = F.linear(embedding, half).unsqueeze(-2) + prepared
        logit: Tensor = self.rest(first)
        return logit.squeeze(-1)


class DifferenceComparator(nn.Module):
    """Compare two embeddings by the absolute difference and product of projections.

    ``f([|Pa - Pb|; Pa * Pb])``: symmetric by construction, and a far better detector
    of places than the concatenation in our trials. A memory's half is its projection.

    Args:
        embedding_dim: length D of the embeddings.
        projection_dim: length of the projections.
        hidden: widths of the hidden layers after them.

    Raises:
        ValueError: if ``hidden`` is empty or holds a width below 1.

    Examples:
        >>> comparator = DifferenceComparator(8, projection_dim=4, hidden=(16,))
        >>> a, b = torch.randn(2, 5, 8)
        >>> torch.equal(comparator(a, b), comparator(b, a))
        True

    Shape notation:
        B: any batch dimensions.  M: memory.  D: embedding.
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
        """One logit per pair: ``[*B, D]`` and ``[*B, D]`` to ``[*B]``."""
        return self._score(self.project(anchor), self.project(other))

    def prepare(self, memory: Tensor) -> Tensor:
        """The memory's projection: ``[*B, M, D]`` to ``[*B, M, P]``."""
        projection: Tensor = self.project(memory)
        return projection

    def compare(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """The rest: ``[*B, D]`` and ``[*B, M, P]`` to logits ``[*B, M]``."""
        return self._score(self.project(embedding).unsqueeze(-2), prepared)

    def _score(self, anchor: Tensor, other: Tensor) -> Tensor:
        features = torch.cat([(anchor - other).abs(), anchor * other], dim=-1)
        logit: Tensor = self.rest(self.first(features))
        return logit.squeeze(-1)
