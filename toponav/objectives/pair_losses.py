"""`TCLoss` and `LLoss`: the losses of the networks on pairs of views."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Never, cast

from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, dispatch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.objectives import LossModule

from toponav.keys import (
    ACTION,
    ANCHOR,
    LABEL,
    LOGIT,
    LOGITS,
    OTHER,
    WEIGHT,
    select_entries,
)
from toponav.objectives.actions import action_numbers
from toponav.objectives.actor_critic_loss import read_entry


class PairLoss(LossModule):
    """What `TCLoss` and `LLoss` share: a (weighted) mean loss and accuracy."""

    functional = False
    #: Which of the accepted keys are the network's prediction and what it should be.
    _predicted: str
    _wanted: str

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        if not isinstance(network, nn.Module):
            raise TypeError(f"network must be a module, got {type(network).__name__}.")
        if not hasattr(network, "in_keys"):
            predicted = getattr(self.tensor_keys, self._predicted)
            network = TensorDictModule(network, [ANCHOR, OTHER], [predicted])
        self.network = network
        self.reduction = "mean"

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> Never:
        """NotImplementedError: pairs of views have no rewards."""
        name, given = type(self).__name__, {"value_type": value_type} | hyperparams
        rule = f"{name} must go without a value estimator, as it reads no reward"
        raise NotImplementedError(f"{rule}, got {given}.")

    @property
    def in_keys(self) -> list[NestedKey]:
        read = cast(list[NestedKey], self.network.in_keys)
        return [*read, getattr(self.tensor_keys, self._wanted)]

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        keys = self.tensor_keys
        # A tensordict of its own, so that the caller's batch gets no prediction.
        read = cast(list[NestedKey], self.network.in_keys)
        inputs = select_entries(tensordict, read)
        results, given = self.network(inputs), tensordict.detach()
        predicted, wanted = (
            read_entry(data, getattr(keys, name), name)
            for data, name in ((results, self._predicted), (given, self._wanted))
        )
        predicted = predicted.float()
        weight = given.get(keys.weight, None)
        measured = [
            self._reduce_loss(value.float(), tensordict, weights=weight)
            for value in self._compare(predicted, wanted)
        ]
        return TensorDict(dict(zip(self.out_keys, measured, strict=True)))

    @abstractmethod
    def _compare(self, predicted: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
        """Loss of each pair, and whether the prediction is right."""


class TCLoss(PairLoss):
    """Train the TC-network by the (weighted) mean binary cross-entropy ``loss_tc``.

    ``network`` makes the logit, ``[*B]``, of ``anchor`` and ``other``, views or
    embeddings; a ``TensorDictModule`` may read other keys. The paper, "Temporal
    correlation network", eq. 5.

    Examples:
        >>> import torch
        >>> network = TensorDictModule(torch.dot, ["anchor", "other"], ["logit"])
        >>> pair = TensorDict(anchor=torch.ones(3), other=torch.zeros(3))
        >>> TCLoss(network)(pair.set("label", torch.tensor(1.0)))["loss_tc"]  # log 2
        tensor(0.6931)
    """

    @dataclass
    class _AcceptedKeys:
        label: NestedKey = LABEL
        logit: NestedKey = LOGIT
        weight: NestedKey = WEIGHT

    default_keys = _AcceptedKeys
    out_keys = ["loss_tc", "accuracy"]
    _predicted, _wanted = "logit", "label"

    def _compare(self, predicted: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
        if predicted.shape != wanted.shape:
            shapes = f"{list(predicted.shape)}, got {list(wanted.shape)}"
            raise ValueError(f"label must have the logit's shape {shapes}.")
        label = wanted.to(predicted.dtype)
        loss = F.binary_cross_entropy_with_logits(predicted, label, reduction="none")
        return loss, (predicted > 0) == (label > 0.5)


class LLoss(PairLoss):
    """Train the L-network by the (weighted) mean cross-entropy ``loss_locomotion``.

    ``network`` makes the logits, ``[*B, A]``, of ``anchor`` and ``other``, views or
    embeddings; a ``TensorDictModule`` may read other keys. Actions are numbers ``[*B]``
    or one-hot: the paper, "Navigation implementation", eq. 14.

    Examples:
        >>> import torch
        >>> network = TensorDictModule(torch.sub, ["anchor", "other"], ["logits"])
        >>> pairs = TensorDict({"anchor": torch.ones(2, 4), "other": torch.ones(2, 4)})
        >>> pairs["action"] = torch.tensor([0, 3])
        >>> LLoss(network)(pairs)["loss_locomotion"]  # of four equal logits: log 4
        tensor(1.3863)
    """

    @dataclass
    class _AcceptedKeys:
        action: NestedKey = ACTION
        logits: NestedKey = LOGITS
        weight: NestedKey = WEIGHT

    default_keys = _AcceptedKeys
    out_keys = ["loss_locomotion", "accuracy"]
    _predicted, _wanted = "logits", "action"

    def _compare(self, predicted: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
        wanted = action_numbers(wanted, predicted.shape[-1], predicted.shape[:-1])
        loss = F.cross_entropy(
            predicted.flatten(0, -2), wanted.flatten(), reduction="none"
        )
        return loss.reshape(wanted.shape), predicted.argmax(-1) == wanted
