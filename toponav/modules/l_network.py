"""`LNetwork` and `LocomotionHead`: the action that leads from one view to another."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn


class LocomotionHead(nn.Module):
    """Predict the action from two embeddings, ``phi_I`` of the paper.

    Args:
        embedding_dim: length D of the embeddings.
        hidden: widths of the hidden layers.
        num_actions: number A of actions.

    Raises:
        ValueError: if ``hidden`` holds a width below 1, or ``num_actions < 2``.

    Examples:
        >>> head = LocomotionHead(8, hidden=(16,))
        >>> head(torch.zeros(5, 8), torch.zeros(5, 8)).shape
        torch.Size([5, 6])

    Shape notation:
        B: any batch dimensions.  D: embedding.  A: actions.
    """

    def __init__(
        self,
        embedding_dim: int = 512,
        *,
        hidden: Sequence[int] = (512, 512),
        num_actions: int = 6,
    ) -> None:
        super().__init__()
        if min(hidden, default=1) < 1:
            raise ValueError(f"hidden must hold widths >= 1, got {hidden}.")
        if num_actions < 2:
            raise ValueError(f"num_actions must be at least 2, got {num_actions}.")
        widths = [2 * embedding_dim, *hidden]
        layers: list[nn.Module] = []
        for width, next_width in pairwise(widths):
            layers += [nn.Linear(width, next_width), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Linear(widths[-1], num_actions))

    def forward(self, anchor: Tensor, other: Tensor) -> Tensor:
        """Logits of the action from here to there: twice ``[*B, D]`` to ``[*B, A]``."""
        logits: Tensor = self.layers(torch.cat([anchor, other], dim=-1))
        return logits


class LNetwork(nn.Module):
    """Predict the action at ``o_i`` that leads to ``o_j`` some decisions later.

    ``P = phi_I(phi_F(o_i), phi_F(o_j))``: one encoder for both views, then the head.
    Hand in the encoder of a `TCNetwork` to share it; on ready embeddings call
    ``network.head``. The softmax is left to the loss and to whoever acts.

    As a TensorDictModule: ``in_keys=["anchor", "other"], out_keys=["logits"]``, for
    the network on views and for ``network.head`` on embeddings alike.

    Reference:
        The paper, "Navigation implementation", eqs. 13 and 14.

    Args:
        encoder: ``[*B, H, W, 3]`` to ``[*B, D]``; may be shared with other networks.
        head: two embeddings to logits, see `LocomotionHead`.

    Raises:
        ValueError: from ``forward``, as the encoder raises it.

    Examples:
        >>> from toponav.modules import SmallEncoder
        >>> network = LNetwork(SmallEncoder(64), LocomotionHead(64)).eval()
        >>> views = torch.zeros(3, 120, 160, 3, dtype=torch.uint8)
        >>> network(views, views).shape
        torch.Size([3, 6])

    Shape notation:
        B: any batch dimensions.  D: embedding.  A: actions.
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
