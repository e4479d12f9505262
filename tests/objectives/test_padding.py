"""Decisions that TorchRL pads a batch with, and masks, change nothing."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict, pad
from torch import nn
from torch.nn.functional import one_hot
from torchrl.collectors.utils import split_trajectories
from torchrl.objectives import ValueEstimators

from tests.objectives.slices import collected_slice
from toponav.keys import TRAJECTORY
from toponav.objectives import A3CLoss, RecurrentPPOLoss, SequenceMinibatches, TRPOLoss

LOSSES = ("loss_objective", "loss_critic", "loss_entropy")
MASK = ("collector", "mask")
EACH = pytest.mark.parametrize("kind", [A3CLoss, RecurrentPPOLoss, TRPOLoss])


def make_loss(kind: type, network: nn.Module, **given: Any) -> Any:
    loss = kind(network, entropy_coeff=0.1, **given)
    return loss.make_value_estimator(ValueEstimators.GAE, gamma=0.9, lmbda=0.8)


def padded(batch: TensorDict) -> TensorDict:
    """With two rows and two decisions of zeros more, and a mask as buffers have it."""
    there = torch.ones(*batch.shape, 1, dtype=torch.bool)
    return pad(batch.copy().set(MASK, there), [0, 2, 0, 2])


@EACH
def test_trajectories_cut_apart_teach_what_their_slices_do(kind: type) -> None:
    network, batch = collected_slice(share=0.0)
    for row, end in ((0, 1), (1, 3)):
        batch["next", "done"][row, end] = True
        batch["is_init"][row, end + 1] = True
    batch["next", "terminated"][1, 3] = True
    # Of 2, 4, 4, 2 and 6 decisions; the slice's end cuts the second and fourth off.
    cut = split_trajectories(batch, trajectory_key=TRAJECTORY)
    assert cut[MASK].sum(-1).tolist() == [2, 4, 4, 2, 6]
    given = {"reduction": "mean"} if kind is A3CLoss else {}
    loss = make_loss(kind, network, **given)
    wanted, found = loss(batch), loss(cut)
    # What is only logged as well.
    for key, value in wanted.items():
        torch.testing.assert_close(found[key], value)


@EACH
@pytest.mark.parametrize("hot", [False, True])
def test_zeros_change_neither_losses_nor_gradients(kind: type, hot: bool) -> None:
    network, batch = collected_slice()
    if hot:
        batch["action"] = one_hot(batch["action"], 2)
    loss = make_loss(kind, network)
    found = []
    for rows in (batch, padded(batch)):
        out = loss(rows)
        network.zero_grad()
        sum(out[key] for key in LOSSES).backward()
        gradients = [one.grad.clone() for one in network.parameters()]
        found.append(([out[key].detach() for key in (*LOSSES, "entropy")], gradients))
    torch.testing.assert_close(found[1], found[0])


@EACH
def test_each_decision_has_the_advantage_that_it_had(kind: type) -> None:
    network, batch = collected_slice()
    if kind is A3CLoss:
        loss = make_loss(kind, network, reduction="none")
        wanted, found = loss(batch), loss(padded(batch))
        for key in LOSSES:
            torch.testing.assert_close(found[key][:3, :6], wanted[key])
            assert not found[key][3:].any()
            assert not found[key][:, 6:].any()
        return
    name = "prepare" if kind is TRPOLoss else "estimate_advantage"
    write = getattr(make_loss(kind, network), name)
    wanted, found = write(batch.copy()), write(padded(batch))
    for key in ("advantage", "value_target"):
        torch.testing.assert_close(found[key][:3, :6], wanted[key])


@EACH
def test_padding_alone_teaches_nothing(kind: type) -> None:
    network, batch = collected_slice()
    out = make_loss(kind, network)(padded(batch)[3:])
    assert not any(out[key] for key in LOSSES)


def test_sequences_and_the_critic_s_minibatches_keep_their_masks() -> None:
    network, batch = collected_slice()
    loss = make_loss(TRPOLoss, network)
    inputs = loss.critic_inputs(loss.prepare(padded(batch)))
    wanted = loss(batch)["loss_critic"]
    for cut in (inputs, inputs.reshape(-1)):
        torch.testing.assert_close(loss.critic_loss(cut), wanted)
    (part,) = SequenceMinibatches(2, num_minibatches=1, seed=0)(padded(batch))
    assert int(part[MASK].sum()) == batch.numel()
