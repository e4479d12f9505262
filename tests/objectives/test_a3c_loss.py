import math
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from tests.objectives.slices import collected_slice, n_step_returns
from toponav.objectives import A3CLoss, RecurrentPPOLoss, SequenceMinibatches


class Given(nn.Module):
    """Two actions; logits and values of the decisions are parameters."""

    in_keys = ["view", "is_init"]

    def __init__(self, logits: Tensor, values: Tensor) -> None:
        super().__init__()
        self.logits = nn.Parameter(logits)
        self.values = nn.Parameter(values)

    def unroll(self, tensordict: TensorDictBase) -> TensorDict:
        return TensorDict({"logits": self.logits, "state_value": self.values}, [1, 2])

    def next_values(self, tensordict: TensorDictBase) -> Tensor:
        return torch.full((*tensordict.batch_size, 1), 8.0)


def n_step(network: nn.Module, gamma: float, **arguments: Any) -> A3CLoss:
    return A3CLoss(network, **arguments).make_value_estimator(gamma=gamma)


def given_batch() -> TensorDict:
    false = torch.zeros(1, 2, 1, dtype=torch.bool)
    following = {"reward": torch.tensor([[[1.0], [2.0]]]), "done": false}
    following |= {"terminated": false, "view": false}
    decisions = {"view": false, "is_init": false, "action": torch.tensor([[0, 1]])}
    return TensorDict({**decisions, "next": following}, [1, 2])


def make_given() -> Given:
    logits = torch.tensor([[[0.0, 0.0], [math.log(3), 0.0]]])
    return Given(logits, torch.tensor([[[1.0], [10.0]]]))


# With gamma 0.5: R_1 = 2 + 8 / 2 = 6 and R_0 = 1 + 6 / 2 = 4, so A = 4 - 1 = 3 and
# 6 - 10 = -4. The probabilities of the actions taken are 1/2 and 1/4.
OBJECTIVE = [3 * math.log(2), -4 * math.log(4)]
CRITIC = [0.5 * 9, 0.5 * 16]
ENTROPY = [math.log(2), math.log(4) - 0.75 * math.log(3)]


def test_worked_numbers() -> None:
    loss = n_step(make_given(), 0.5, entropy_coeff=0.1, reduction="none")
    out = loss(given_batch())
    for key, expected in (
        ("loss_objective", OBJECTIVE),
        ("loss_critic", CRITIC),
        ("loss_entropy", [-0.1 * e for e in ENTROPY]),
        ("entropy", ENTROPY),
    ):
        torch.testing.assert_close(out[key], torch.tensor([expected]))


@pytest.mark.parametrize(
    ("reduction", "divisor"), [("unroll", 1), ("sum", 1), ("mean", 2)]
)
def test_reductions_of_one_row(reduction: str, divisor: int) -> None:
    loss = n_step(make_given(), 0.5, reduction=reduction)
    out = loss(given_batch())
    assert out["loss_critic"].item() == pytest.approx(sum(CRITIC) / divisor)
    assert out["loss_objective"].item() == pytest.approx(sum(OBJECTIVE) / divisor)
    assert out["entropy"].item() == pytest.approx(sum(ENTROPY) / 2)


def test_an_unroll_is_summed_over_time_and_averaged_over_rows() -> None:
    network, batch = collected_slice(rows=3, steps=6)
    means, sums, unrolls = (
        A3CLoss(network, reduction=r)(batch)  # type: ignore[arg-type]
        for r in ("mean", "sum", "unroll")
    )
    for key in ("loss_objective", "loss_critic", "loss_entropy"):
        torch.testing.assert_close(unrolls[key], 6 * means[key])
        torch.testing.assert_close(unrolls[key], sums[key] / 3)


def test_the_gradient_points_where_the_advantage_says() -> None:
    network = make_given()
    out = n_step(network, 0.5, entropy_coeff=0.0)(given_batch())
    out["loss_objective"].backward()
    # d(-log p_a A) / d logit is (p - 1) A for the action taken and p A for the other:
    # it falls, so the logit rises, for the action with A = 3, and the reverse for -4.
    expected = torch.tensor([[[-1.5, 1.5], [-3.0, 3.0]]])
    torch.testing.assert_close(network.logits.grad, expected)
    assert network.values.grad is None
    out["loss_critic"].backward()
    # d 0.5 (R - V)^2 / dV = V - R
    torch.testing.assert_close(network.values.grad, torch.tensor([[[-3.0], [4.0]]]))


def test_the_entropy_bonus_pulls_towards_uniform() -> None:
    network = make_given()
    A3CLoss(network, entropy_coeff=1.0)(given_batch())["loss_entropy"].backward()
    assert not network.logits.grad[0, 0].any()
    # Descending lowers the likelier action's logit.
    assert network.logits.grad[0, 1, 0] > 0 > network.logits.grad[0, 1, 1]


@pytest.mark.parametrize("seed", range(5))
def test_it_equals_the_definition_on_collected_slices(seed: int) -> None:
    torch.manual_seed(seed)
    network, batch = collected_slice(seed, rows=4, steps=7)
    loss = n_step(network, 0.9, reduction="none")
    out = loss(batch)
    value, following = batch["state_value"], batch["next"]
    returns = n_step_returns(
        following["reward"],
        network.next_values(batch),
        (following["done"], following["terminated"]),
        0.9,
    )
    advantage = (returns - value).squeeze(-1)
    log_prob = batch["action_log_prob"]
    tolerance = {"atol": 1e-5, "rtol": 1e-4}
    torch.testing.assert_close(
        out["loss_objective"], -log_prob * advantage, **tolerance
    )
    torch.testing.assert_close(out["loss_critic"], 0.5 * advantage**2, **tolerance)


def test_losses_know_of_the_view_after_a_cut_episode() -> None:
    """A clock's end bootstraps from its own last view, a terminated one from none."""
    network, batch = collected_slice(share=0.0)
    batch["next", "done"][:, 2] = True
    batch["is_init"][:, 3] = True

    def critic_losses() -> Tensor:
        out: Tensor = A3CLoss(network, reduction="none")(batch)["loss_critic"]
        return out.detach()

    before = critic_losses()
    batch["next", "embedding"][:, 2] += 1
    changed = critic_losses() != before
    assert changed[:, :3].all()
    assert not changed[:, 3:].any()
    batch["next", "terminated"][:, 2] = True
    terminated = critic_losses()
    batch["next", "embedding"][:, 2] += 1
    assert torch.equal(critic_losses(), terminated)


def test_gradients_reach_every_weight_and_the_batch_is_left_alone() -> None:
    network, batch = collected_slice()
    keys = set(batch.keys(True, True))
    out = A3CLoss(network)(batch)
    assert not out["entropy"].requires_grad
    sum(out[k] for k in ("loss_objective", "loss_critic", "loss_entropy")).backward()
    assert all(p.grad is not None and p.grad.any() for p in network.parameters())
    assert set(batch.keys(True, True)) == keys


def test_an_early_view_learns_from_a_late_reward_through_the_memory() -> None:
    network, batch = collected_slice(share=0.0)
    batch["embedding"][:, 1:] = 0
    loss = A3CLoss(network, reduction="none")
    loss(batch)["loss_objective"][:, -1].sum().backward()
    assert network.trunk.project.weight.grad.any()
    # With an episode's start in between, nothing comes back.
    network.zero_grad()
    batch["is_init"][:, 3] = True
    loss(batch)["loss_objective"][:, -1].sum().backward()
    assert not network.trunk.project.weight.grad.any()


def test_the_network_stays_the_caller_s_own() -> None:
    network, _ = collected_slice()
    assert list(A3CLoss(network).parameters()) == list(network.parameters())


def test_coefficients_can_be_assigned_while_training() -> None:
    network, batch = collected_slice()
    loss = A3CLoss(network, entropy_coeff=0.01)
    before = loss(batch)["loss_entropy"]
    loss.entropy_coeff = 0.02
    torch.testing.assert_close(loss(batch)["loss_entropy"], 2 * before)


def test_keys_can_be_set() -> None:
    network, batch = collected_slice()
    loss = A3CLoss(network)
    expected = loss(batch)["loss_critic"]
    batch["next", "intrinsic_reward"] = batch["next"].pop("reward")
    loss.set_keys(reward="intrinsic_reward")
    assert loss(batch)["loss_critic"] == expected
    assert ("next", "intrinsic_reward") in loss.in_keys
    with pytest.raises(ValueError, match="not an accepted tensordict key"):
        loss.set_keys(rewards="intrinsic_reward")


def test_in_keys_are_all_it_reads() -> None:
    network, batch = collected_slice()
    loss = A3CLoss(network)
    expected = loss(batch)
    assert (loss(batch.select(*loss.in_keys)) == expected).all()
    assert list(expected.keys()) == loss.out_keys


def test_it_can_be_called_without_a_tensordict() -> None:
    network, batch = collected_slice()
    loss = A3CLoss(network)
    entries = {
        "_".join(key) if isinstance(key, tuple) else key: batch[key]
        for key in loss.in_keys
    }
    results = loss(**entries)
    expected = loss(batch)
    for key, result in zip(loss.out_keys, results, strict=True):
        assert result == expected[key]


def test_one_hot_actions_give_the_same_losses() -> None:
    network, batch = collected_slice()
    for loss in (A3CLoss(network), RecurrentPPOLoss(network)):
        expected = loss(batch)
        one_hot = batch.clone()
        one_hot["action"] = nn.functional.one_hot(batch["action"], 2)
        assert (loss(one_hot) == expected).all()


def test_every_key_can_be_set() -> None:
    """Of the entries of a plain actor and critic, each under another name."""
    network, batch = collected_slice()
    expected = A3CLoss(network)(batch)
    names = ("action", "reward", "done", "terminated")
    loss = A3CLoss(network)
    loss.set_keys(**{name: ("agent", name) for name in names})
    for name in names:
        side = batch if name == "action" else batch["next"]
        side["agent", name] = side.pop(name)
    assert (loss(batch) == expected).all()
    assert (loss(batch.select(*loss.in_keys)) == expected).all()


def test_an_advantage_that_is_there_is_used() -> None:
    network, batch = collected_slice()
    loss = A3CLoss(network, reduction="none")
    batch["advantage"] = torch.ones_like(batch["state_value"])
    batch["value_target"] = batch["state_value"] + 2
    out = loss(batch)
    torch.testing.assert_close(out["loss_objective"], -batch["action_log_prob"])
    torch.testing.assert_close(
        out["loss_critic"], torch.full_like(out["loss_critic"], 2)
    )
    with pytest.raises(KeyError, match="'value_target', the key of value_target"):
        loss(batch.exclude("value_target"))


def test_given_targets_of_another_shape_are_refused() -> None:
    network, batch = collected_slice()
    batch["advantage"] = batch["value_target"] = batch["state_value"]
    for key in ("advantage", "value_target"):
        flat = batch.copy().set(key, batch["state_value"].squeeze(-1))
        with pytest.raises(
            ValueError, match=rf"'{key}'.* shape \[3, 6, 1\], got \[3, 6\]"
        ):
            A3CLoss(network)(flat)


def test_a_flat_batch_is_refused() -> None:
    network, batch = collected_slice()
    message = r"must be \[\*B, T\].* got \[18\]: .*unsqueeze\(0\).*reshape\(-1, T"
    for loss in (A3CLoss(network), RecurrentPPOLoss(network)):
        with pytest.raises(ValueError, match=message):
            loss(batch.reshape(-1))
    with pytest.raises(ValueError, match=message):
        RecurrentPPOLoss(network).estimate_advantage(batch.reshape(-1))
    with pytest.raises(ValueError, match=message):
        next(iter(SequenceMinibatches(6, num_minibatches=1)(batch.reshape(-1))))


def test_a_batch_without_time_is_refused() -> None:
    network, batch = collected_slice()
    with pytest.raises(ValueError, match=r"rows of T successive decisions, got \[\]"):
        A3CLoss(network)(batch[0, 0])


def test_only_keys_that_are_read_can_be_set() -> None:
    loss = A3CLoss(make_given())
    for name in ("is_init", "sample_log_prob"):
        with pytest.raises(ValueError, match="not an accepted tensordict key"):
            loss.set_keys(**{name: "other"})
    loss.set_keys(logits="scores")
    with pytest.raises(KeyError, match=r"'scores', the key of logits .*'logits'"):
        loss(given_batch())


def test_actions_that_nobody_can_take_are_refused() -> None:
    network, batch = collected_slice()
    one_hot = nn.functional.one_hot(batch["action"], 2)
    for action, message in (
        (batch["action"] + 6, r"in \[0, 2\), got numbers from 6 to 7"),
        (batch["action"] - 1, r"in \[0, 2\), got numbers from -1 to 0"),
        (batch["action"].float(), r"integers or bools, got torch.float32"),
        (one_hot.float(), r"integers or bools, got torch.float32"),
        (one_hot * 0, r"one-hot, got \[0, 0\]"),
    ):
        for loss in (A3CLoss(network), RecurrentPPOLoss(network)):
            with pytest.raises(ValueError, match=f"action must be {message}"):
                loss(batch.copy().set("action", action))


def test_arguments_out_of_range_are_refused() -> None:
    network, batch = collected_slice()
    message = r"without a critic_network must be .* got Linear without in_keys, unroll,"
    with pytest.raises(TypeError, match=message):
        A3CLoss(nn.Linear(2, 2))
    with pytest.raises(KeyError, match="must have 'action', the key of action"):
        A3CLoss(network)(batch.exclude("action"))
    batch["action"] = batch["action"].unsqueeze(-1)
    with pytest.raises(
        ValueError,
        match=r"numbers of the shape \[3, 6\] or one-hot .* got \[3, 6, 1\]",
    ):
        A3CLoss(network)(batch)
    with pytest.raises(ValueError, match=r"reduction must be one of .* got 'max'"):
        A3CLoss(network, reduction="max")  # type: ignore[arg-type]
