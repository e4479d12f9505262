"""The TC-network, its comparators and the L-network: from two views to an answer."""

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.modules import MLP

from toponav.parts import require_callables, require_parts


class Comparator(Protocol):
    """What `TCNetwork` asks of a comparator of embeddings of length D."""

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
    """Compare two embeddings by a perceptron on their concatenation.

    The first layer is split, so that a memory's half is computed once. Not symmetric;
    training swaps pairs at random. ``hidden`` are the widths of its layers.

    Reference:
        The paper, phi_C of eq. 5: four hidden layers of 512 with ReLU.
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


class TCNetwork(nn.Module):
    """Score how close in time two views are, ``tc = phi_C(phi_E(o_i), phi_E(o_j))``.

    Training calls it on pairs of views and gets logits. Rewards and maps `embed` each
    view once and `compare` it with a memory, as probabilities, after ``eval()``.

    Reference:
        The paper, "Temporal correlation network", eq. 5.

    Args:
        encoder: views to ``[*B, D]``, their channels first or last; may be shared.
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
        require_callables(encoder=encoder)
        wanted = ("prepare", "compare")
        require_parts(comparator, "comparator", "a ConcatComparator", *wanted)
        self.encoder = encoder
        self.comparator = comparator

    def forward(self, anchor: Tensor, other: Tensor) -> Tensor:
        """Logits of pairs of views, as the encoder takes them: ``[*B]``."""
        # One call of the encoder: batch normalisation then sees both sides at once.
        embedding_anchor, embedding_other = self.embed(torch.stack([anchor, other]))
        return self.comparator(embedding_anchor, embedding_other)

    def embed(self, pixels: Tensor) -> Tensor:
        """Embeddings of views, as the encoder takes them: ``[*B, D]``."""
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


class LocomotionHead(nn.Module):
    """Predict the action from two embeddings, ``phi_I``; ``hidden`` are its widths."""

    def __init__(
        self,
        embedding_dim: int = 512,
        *,
        num_actions: int,
        hidden: Sequence[int] = (512, 512),
    ) -> None:
        super().__init__()
        if min(hidden, default=1) < 1:
            raise ValueError(f"hidden must hold widths >= 1, got {hidden}.")
        if num_actions < 2:
            raise ValueError(f"num_actions must be at least 2, got {num_actions}.")
        self.num_actions = num_actions
        self.layers = MLP(
            2 * embedding_dim, num_actions, num_cells=hidden, activation_class=nn.ReLU
        )

    def forward(self, anchor: Tensor, other: Tensor) -> Tensor:
        """Logits of the action from here to there: twice ``[*B, D]`` to ``[*B, A]``."""
        logits: Tensor = self.layers(anchor, other)
        return logits


class LNetwork(nn.Module):
    """Logits of the action at ``o_i`` that leads to ``o_j`` some decisions later.

    Its ``encoder``, views to ``[*B, D]``, may be that of a `TCNetwork`; its
    ``head`` takes embeddings that exist already.

    Reference:
        The paper, "Navigation implementation", eqs. 13 and 14.

    Examples:
        >>> from toponav.modules import LocomotionHead, SmallEncoder
        >>> encoder = SmallEncoder(64, image_size=(24, 32))
        >>> network = LNetwork(encoder, LocomotionHead(64, num_actions=4))
        >>> views = torch.zeros(3, 24, 32, 3, dtype=torch.uint8)
        >>> network(views, views).shape  # a logit of each action, for each pair
        torch.Size([3, 4])
    """

    def __init__(self, encoder: nn.Module, head: LocomotionHead) -> None:
        super().__init__()
        require_callables(encoder=encoder, head=head)
        self.encoder = encoder
        self.head = head

    def forward(self, anchor: Tensor, other: Tensor) -> Tensor:
        """Logits of pairs of views, as the encoder takes them: ``[*B, A]``."""
        # One call of the encoder: batch normalisation then sees both sides at once.
        here, there = self.encoder(torch.stack([anchor, other]))
        logits: Tensor = self.head(here, there)
        return logits
