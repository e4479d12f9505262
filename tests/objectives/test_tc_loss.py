import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from toponav.objectives import TCLoss


class Bilinear(nn.Module):
    """A small network on pairs of embeddings of length 4."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(8, 32), nn.ReLU(), nn.Linear(32, 1))

    def forward(self, anchor: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        logit: torch.Tensor = self.layers(torch.cat([anchor, other], -1))
        return logit.squeeze(-1)


def make_loss(network: nn.Module, out_key: str = "logit") -> TCLoss:
    return TCLoss(
        TensorDictModule(network, in_keys=["anchor", "other"], out_keys=[out_key])
    )


def make_pairs(num: int = 16) -> TensorDict:
    generator = torch.Generator().manual_seed(0)
    return TensorDict(
        {
            "anchor": torch.randn(num, 4, generator=generator),
            "other": torch.randn(num, 4, generator=generator),
            "label": torch.tensor([0.0, 1.0]).repeat(num // 2),
        },
        [num],
    )


class Given(nn.Module):
    """Takes the anchor's first number for the logit."""

    def forward(self, anchor: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        return anchor[..., 0]


def given_pairs(logit: list[float], label: list[float]) -> TensorDict:
    anchor = torch.tensor(logit).unsqueeze(-1)
    return TensorDict(
        {"anchor": anchor, "other": anchor, "label": torch.tensor(label)}, [len(logit)]
    )


def test_worked_numbers() -> None:
    pairs = given_pairs([0.0, 2.0, 2.0], [1, 1, 0])
    out = make_loss(Given())(pairs)
    # log 2 + log(1 + e^-2) + log(1 + e^2), over three; 0 is not above the threshold.
    expected = math.log(2) + math.log(1 + math.exp(-2)) + math.log(1 + math.exp(2))
    assert out["loss_tc"].item() == pytest.approx(expected / 3)
    assert out["accuracy"].item() == pytest.approx(1 / 3)


def test_accuracy_counts_the_sides_of_zero() -> None:
    out = make_loss(Given())(given_pairs([0.2, -0.2, 0.2], [1, 0, 1]))
    assert out["accuracy"].item() == 1


def test_weights_make_a_weighted_mean() -> None:
    pairs = given_pairs([2.0, 2.0], [1, 0])
    pairs["weight"] = torch.tensor([3.0, 1.0])
    out = make_loss(Given())(pairs)
    # (3 log(1 + e^-2) + log(1 + e^2)) / 4
    expected = (3 * math.log(1 + math.exp(-2)) + math.log(1 + math.exp(2))) / 4
    assert out["loss_tc"].item() == pytest.approx(expected)
    assert out["accuracy"].item() == pytest.approx(0.75)


def test_the_loss_is_float32_from_bfloat16_logits() -> None:
    pairs = given_pairs([2.0, 2.0], [1, 0])
    pairs["anchor"] = pairs["anchor"].bfloat16()
    assert make_loss(Given())(pairs)["loss_tc"].dtype == torch.float32


def test_gradients_reach_the_network_and_nothing_else() -> None:
    network = Bilinear()
    pairs = make_pairs()
    pairs["label"].requires_grad_()
    pairs["weight"] = torch.ones(16, requires_grad=True)
    out = make_loss(network)(pairs)
    assert not out["accuracy"].requires_grad
    out["loss_tc"].backward()
    assert all(p.grad is not None for p in network.parameters())
    assert pairs["label"].grad is None
    assert pairs["weight"].grad is None


def test_gradients_pass_through_to_embeddings() -> None:
    pairs = make_pairs()
    pairs["anchor"].requires_grad_()
    make_loss(Bilinear())(pairs)["loss_tc"].backward()
    assert pairs["anchor"].grad is not None


def test_the_network_stays_the_caller_s_own() -> None:
    network = nn.Sequential(nn.BatchNorm1d(4))
    loss = make_loss(network)
    assert list(loss.parameters()) == list(network.parameters())
    loss.eval()
    assert not network[0].training


def test_the_batch_is_left_alone() -> None:
    pairs = make_pairs()
    make_loss(Bilinear())(pairs)
    assert set(pairs.keys()) == {"anchor", "other", "label"}


def test_keys_can_be_set() -> None:
    loss = make_loss(Bilinear(), out_key="score")
    loss.set_keys(logit="score", label=("pair", "close"), weight="importance")
    plain = make_pairs()
    pairs = plain.copy()
    pairs["pair", "close"] = pairs.pop("label")
    pairs["importance"] = torch.arange(16.0)
    out = loss(pairs)
    loss.set_keys(weight=None)
    assert loss.tensor_keys.weight == "weight"
    assert out["loss_tc"] != loss(pairs)["loss_tc"]
    assert loss.in_keys == ["anchor", "other", ("pair", "close")]
    with pytest.raises(ValueError, match="not an accepted tensordict key"):
        loss.set_keys(labels="label")


def test_it_can_be_called_without_a_tensordict() -> None:
    pairs = make_pairs()
    loss = make_loss(Bilinear())
    loss_tc, accuracy = loss(**pairs.to_dict())
    assert loss_tc == loss(pairs)["loss_tc"]
    assert accuracy == loss(pairs)["accuracy"]


def test_it_overfits_one_batch() -> None:
    torch.manual_seed(0)
    loss, pairs = make_loss(Bilinear()), make_pairs()
    optimizer = torch.optim.Adam(loss.parameters(), lr=0.05)
    for _ in range(80):
        out = loss(pairs)
        optimizer.zero_grad()
        out["loss_tc"].backward()
        optimizer.step()
    assert out["loss_tc"].item() < 0.05
    assert out["accuracy"].item() == 1


def test_shapes_that_differ_are_refused() -> None:
    pairs = make_pairs()
    pairs["label"] = pairs["label"].unsqueeze(-1)
    with pytest.raises(ValueError, match=r"logit's shape \[16\], got \[16, 1\]"):
        make_loss(Bilinear())(pairs)


def test_a_plain_module_reads_the_two_of_a_pair() -> None:
    network, pairs = Bilinear(), make_pairs()
    found, expected = TCLoss(network)(pairs), make_loss(network)(pairs)
    assert (found == expected).all()
    assert TCLoss(network).in_keys == ["anchor", "other", "label"]
    with pytest.raises(TypeError, match="network must be a module, got builtin_funct"):
        TCLoss(torch.dot)
