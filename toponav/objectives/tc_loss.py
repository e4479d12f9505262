"""`TCLoss`: binary cross-entropy of the TC-network on labelled pairs."""

from dataclasses import dataclass

from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, dispatch
from torch.nn import functional as F  # noqa: N812
from torchrl.objectives import LossModule

from toponav.keys import LABEL, LOGIT, WEIGHT


class TCLoss(LossModule):
    """Train the TC-network to tell close pairs of views from distant ones.

    ``loss_tc`` is the (weighted) mean binary cross-entropy of the logits, and
    ``accuracy`` the (weighted) share on the right side of 0, without gradient. The
    network may read views or ready embeddings, whatever its ``in_keys`` name. It stays
    an ordinary submodule, not a functional copy: there is no target network, the
    encoder may be shared with `LLoss`, and batch normalisation must follow ``train()``.

    Reference:
        The paper, "Temporal correlation network": "trained with logistic regression
        losses", eq. 5.

    Args:
        tc_network: reads the pairs and writes the logit, ``[*B]``.

    Raises:
        ValueError: from ``forward``, if logit and label differ in shape.

    Examples:
        >>> import torch
        >>> network = TensorDictModule(
        ...     lambda a, b: -(a - b).abs().sum(-1),
        ...     in_keys=["anchor", "other"],
        ...     out_keys=["logit"],
        ... )
        >>> loss = TCLoss(network)
        >>> pairs = TensorDict(
        ...     {
        ...         "anchor": torch.zeros(2, 3),
        ...         "other": torch.tensor([[0.0, 0, 0], [1, 1, 1]]),
        ...         "label": torch.tensor([1.0, 0.0]),
        ...     },
        ...     [2],
        ... )
        >>> loss(pairs)["loss_tc"]  # (log 2 + log(1 + e^-3)) / 2
        tensor(0.3709)

    Shape notation:
        B: batch of pairs.
    """

    @dataclass
    class _AcceptedKeys:
        """Keys that ``set_keys`` can change.

        Attributes:
            label: float ``[*B]``; 1 close, 0 distant.
            logit: float ``[*B]``; where the network writes.
            weight: float ``[*B]``; how much each pair counts, read if present.
        """

        label: NestedKey = LABEL
        logit: NestedKey = LOGIT
        weight: NestedKey = WEIGHT

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys

    out_keys = ["loss_tc", "accuracy"]

    def __init__(self, tc_network: TensorDictModule) -> None:
        super().__init__()
        self.tc_network = tc_network
        self.reduction = "mean"

    @property
    def functional(self) -> bool:
        return False

    @property
    def in_keys(self) -> list[NestedKey]:
        """The network's keys and the label; the weight is optional."""
        return [*self.tc_network.in_keys, self.tensor_keys.label]

    def _forward_value_estimator_keys(self, **kwargs: NestedKey) -> None:
        pass

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        # A shallow copy, so that the caller's batch gets no logit.
        logit = self.tc_network(tensordict.copy()).get(self.tensor_keys.logit).float()
        label = tensordict.get(self.tensor_keys.label).detach().to(logit.dtype)
        if logit.shape != label.shape:
            raise ValueError(
                f"label must have the logit's shape {list(logit.shape)}, got "
                f"{list(label.shape)}."
            )
        weight = tensordict.get(self.tensor_keys.weight, None)
        if weight is not None:
            weight = weight.detach()
        loss = F.binary_cross_entropy_with_logits(logit, label, reduction="none")
        is_right = ((logit.detach() > 0) == (label > 0.5)).to(logit.dtype)
        return TensorDict(
            {
                "loss_tc": self._reduce_loss(loss, tensordict, weights=weight),
                "accuracy": self._reduce_loss(is_right, tensordict, weights=weight),
            }
        )
