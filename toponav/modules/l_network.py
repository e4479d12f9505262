"""`LNetwork` and `LocomotionHead`: the action that leads from one view to another."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.modules import MLP


class LocomotionHead(nn.Module):
    """Predict the action from two embeddings, ``phi_I`` of the paper.

    Args:
        embedding_dim: length D of the embeddings.
        num_actions: number A of actions, at least 2.
        hidden: widths of the hidden layers, each at least 1.
    """

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

    Give it the encoder of a `TCNetwork` to share it; call ``network.head`` on
    embeddings that exist already.

    Reference:
        The paper, "Navigation implementation", eqs. 13 and 14.

    Args:
        encoder: ``[*B, H, W, 3]`` to ``[*B, D]``.
        head: two embeddings to logits, see `LocomotionHead`.
    """

    def __init__(self, encoder: nn.Module, head: LocomotionHead) -> None:
        super().__init__()
        self.encoder = encoder
        self.head = head

    def forward(self, anchor: Tensor, other: Tensor) -> Tensor:
        """Logits of pairs of views: twice ``[*B, H, W, 3]`` to ``[*B, A]``."""
        # One call of the encoder: batch normalisation then sees both sides at once.
        here, there = self.encoder(torch.stack([anchor, other]))
        logits: Tensor = self.head(here, there)
        return logits
