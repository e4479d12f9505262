import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from toponav.objectives import LLoss


class Head(nn.Module):
    """A small network from pairs of embeddings of length 4 to six logits."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(8, 32), nn.ReLU(), nn.Linear(32, 6))

    def forward(self, anchor: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        logits: torch.Tensor = self.layers(torch.cat([anchor, other], -1))
        return logits


class Given(nn.Module):
    """Takes the anchor for the logits."""

    def forward(self, anchor: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        return anchor


def make_loss(network: nn.Module, out_key: str = "logits") -> LLoss:
    return LLoss(
        TensorDictModule(network, in_keys=["anchor", "other"], out_keys=[out_key])
    )


def make_pairs(*batch: int) -> TensorDict:
    generator = torch.Generator().manual_seed(0)
    return TensorDict(
        {
            "anchor": torch.randn(*batch, 4, generator=generator),
            "other": torch.randn(*batch, 4, generator=generator),
            "action": torch.randint(6, batch, generator=generator),
        },
        batch,
    )


def given_pairs() -> TensorDict:
    anchor = torch.tensor([[1.0, 0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0, 0]])
    action = torch.tensor([0, 3])
    return TensorDict({"anchor": anchor, "other": anchor, "action": action}, [2])


def test_worked_numbers() -> None:
    out = make_loss(Given())(given_pairs())
    # log(e + 5) - 1 for the first, log(e + 5) for the second, over two.
    expected = math.log(math.e + 5) - 0.5
    assert out["loss_locomotion"].item() == pytest.approx(expected)
    assert out["accuracy"].item() == 0.5


def test_weights_make_a_weighted_mean() -> None:
    pairs = given_pairs()
    pairs["weight"] = torch.tensor([3.0, 1.0])
    out = make_loss(Given())(pairs)
    # (3 (log(e + 5) - 1) + log(e + 5)) / 4
    expected = math.log(math.e + 5) - 0.75
    assert out["loss_locomotion"].item() == pytest.approx(expected)
    assert out["accuracy"].item() == 0.75


def test_the_loss_is_float32_from_bfloat16_logits() -> None:
    pairs = given_pairs()
    pairs["anchor"] = pairs["anchor"].bfloat16()
    assert make_loss(Given())(pairs)["loss_locomotion"].dtype == torch.float32


def test_any_batch_shape_gives_the_same() -> None:
    loss, pairs = make_loss(Head()), make_pairs(4, 3)
    torch.testing.assert_close(
        loss(pairs)["loss_locomotion"], loss(pairs.reshape(-1))["loss_locomotion"]
    )


def test_gradients_reach_the_network_and_nothing_else() -> None:
    network, pairs = Head(), make_pairs(16)
    pairs["weight"] = torch.ones(16, requires_grad=True)
    out = make_loss(network)(pairs)
    assert not out["accuracy"].requires_grad
    out["loss_locomotion"].backward()
    assert all(p.grad is not None for p in network.parameters())
    assert pairs["weight"].grad is None


def test_gradients_pass_through_to_embeddings() -> None:
    pairs = make_pairs(16)
    pairs["anchor"].requires_grad_()
    make_loss(Head())(pairs)["loss_locomotion"].backward()
    assert pairs["anchor"].grad is not None


def test_the_network_stays_the_caller_s_own() -> None:
    network = Head()
    loss = make_loss(network)
    assert list(loss.parameters()) == list(network.parameters())
    loss.eval()
    assert not network.training


def test_the_batch_is_left_alone() -> None:
    pairs = make_pairs(16)
    make_loss(Head())(pairs)
    assert set(pairs.keys()) == {"anchor", "other", "action"}


def test_keys_can_be_set() -> None:
    loss = make_loss(Head(), out_key=("policy", "logits"))
    loss.set_keys(logits=("policy", "logits"), action="taken", weight="importance")
    pairs = make_pairs(16).rename_key_("action", "taken")
    pairs["importance"] = torch.arange(16.0)
    out = loss(pairs)
    loss.set_keys(weight=None)
    assert out["loss_locomotion"] != loss(pairs)["loss_locomotion"]
    assert loss.in_keys == ["anchor", "other", "taken"]
    with pytest.raises(ValueError, match="not an accepted tensordict key"):
        loss.set_keys(actions="taken")


def test_it_can_be_called_without_a_tensordict() -> None:
    pairs, loss = make_pairs(16), make_loss(Head())
    loss_locomotion, accuracy = loss(**pairs.to_dict())
    assert loss_locomotion == loss(pairs)["loss_locomotion"]
    assert accuracy == loss(pairs)["accuracy"]


def test_it_overfits_one_batch() -> None:
    torch.manual_seed(0)
    loss, pairs = make_loss(Head()), make_pairs(16)
    optimizer = torch.optim.Adam(loss.parameters(), lr=0.05)
    for _ in range(80):
        out = loss(pairs)
        optimizer.zero_grad()
        out["loss_locomotion"].backward()
        optimizer.step()
    assert out["loss_locomotion"].item() < 0.05
    assert out["accuracy"].item() == 1


def test_shapes_that_differ_are_refused() -> None:
    pairs = make_pairs(16)
    pairs["action"] = pairs["action"].unsqueeze(-1)
    with pytest.raises(ValueError, match=r"shape \[16\] or one-hot .*got \[16, 1\]"):
        make_loss(Head())(pairs)


def test_one_hot_actions_give_the_same_loss() -> None:
    pairs = make_pairs(16)
    loss = make_loss(Head())
    expected = loss(pairs)
    logits = loss.network(pairs.copy())["logits"]
    one_hot = torch.nn.functional.one_hot(pairs["action"], logits.shape[-1])
    assert (loss(pairs.copy().set("action", one_hot)) == expected).all()


def test_what_is_missing_is_named() -> None:
    pairs = make_pairs(16)
    with pytest.raises(KeyError, match="must have 'action', the key of action"):
        make_loss(Head())(pairs.exclude("action"))


def test_a_plain_module_reads_the_two_of_a_pair() -> None:
    network, pairs = Head(), make_pairs(16)
    assert (LLoss(network)(pairs) == make_loss(network)(pairs)).all()
