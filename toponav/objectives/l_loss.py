"""`LLoss`: cross-entropy of the L-network on the action between two views."""

from dataclasses import dataclass

from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, dispatch
from torch.nn import functional as F  # noqa: N812
from torchrl.objectives import LossModule

from toponav.keys import ACTION, LOGITS, WEIGHT


class LLoss(LossModule):
    """Train the L-network to name the action that began the way between two views.

    ``loss_locomotion`` is the (weighted) mean cross-entropy of the logits, and
    ``accuracy`` the (weighted) share whose most likely action is the one taken, without
    gradient. The network may read views or ready embeddings, whatever its ``in_keys``
    name. It stays an ordinary submodule, not a functional copy: there is no target
    network, the encoder may be shared with `TCLoss`, and batch normalisation must
    follow ``train()``.

    Reference:
        The paper, "Navigation implementation", eq. 14.

    Args:
        l_network: reads the pairs and writes the logits, ``[*B, A]``.

    Raises:
        ValueError: from ``forward``, if the action's shape is not the logits' without
            the last dimension.

    Examples:
        >>> import torch
        >>> network = TensorDictModule(
        ...     torch.sub, in_keys=["anchor", "other"], out_keys=["logits"]
        ... )
        >>> loss = LLoss(network)
        >>> pairs = TensorDict(
        ...     {
        ...         "anchor": torch.zeros(1, 6),
        ...         "other": torch.zeros(1, 6),
        ...         "action": torch.tensor([2]),
        ...     },
        ...     [1],
        ... )
        >>> loss(pairs)["loss_locomotion"]  # log 6
        tensor(1.7918)

    Shape notation:
        B: batch of pairs.  A: actions.
    """

    @dataclass
    class _AcceptedKeys:
        """Keys that ``set_keys`` can change.

        Attributes:
            action: int64 ``[*B]``; the action taken at the anchor.
            logits: float ``[*B, A]``; where the network writes.
            weight: float ``[*B]``; how much each pair counts, read if present.
        """

        action: NestedKey = ACTION
        logits: NestedKey = LOGITS
        weight: NestedKey = WEIGHT

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys

    out_keys = ["loss_locomotion", "accuracy"]

    def __init__(self, l_network: TensorDictModule) -> None:
        super().__init__()
        self.l_network = l_network
        self.reduction = "mean"

    @property
    def functional(self) -> bool:
        return False

    @property
    def in_keys(self) -> list[NestedKey]:
        """The network's keys and the action; the weight is optional."""
        return [*self.l_network.in_keys, self.tensor_keys.action]

    def _forward_value_estimator_keys(self, **kwargs: NestedKey) -> None:
        pass

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        # A shallow copy, so that the caller's batch gets no logits.
        logits = self.l_network(tensordict.copy()).get(self.tensor_keys.logits).float()
        action = tensordict.get(self.tensor_keys.action)
        if logits.shape[:-1] != action.shape:
            raise ValueError(
                f"action must have the shape {list(logits.shape[:-1])} of the logits "
                f"without their last dimension, got {list(action.shape)}."
            )
        weight = tensordict.get(self.tensor_keys.weight, None)
        if weight is not None:
            weight = weight.detach()
        loss = F.cross_entropy(
            logits.flatten(0, -2), action.flatten(), reduction="none"
        ).reshape(action.shape)
        is_right = (logits.detach().argmax(-1) == action).to(logits.dtype)
        return TensorDict(
            {
                "loss_locomotion": self._reduce_loss(loss, tensordict, weights=weight),
                "accuracy": self._reduce_loss(is_right, tensordict, weights=weight),
            }
        )
