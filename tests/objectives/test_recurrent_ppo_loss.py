from unittest.mock import patch

import pytest
import torch

from tests.objectives.slices import collected_slice, n_step_returns
from toponav.objectives import RecurrentPPOLoss, SequenceMinibatches

LOSSES = ("loss_objective", "loss_critic", "loss_entropy")


def test_the_policy_that_collected_stands_at_ratio_one() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    out = loss(loss.estimate_advantage(batch, normalize=False))
    assert out["kl_approx"].item() == pytest.approx(0, abs=1e-6)
    assert out["clip_fraction"] == 0
    mean = batch["advantage"].mean()
    torch.testing.assert_close(out["loss_objective"], -mean, atol=1e-5, rtol=1e-4)
    error = (batch["value_target"] - batch["state_value"]).square().mean()
    torch.testing.assert_close(out["loss_critic"], 0.5 * error)


def test_sequences_start_from_their_stored_state() -> None:
    network, batch = collected_slice(rows=4, steps=6)
    loss = RecurrentPPOLoss(network)
    loss.estimate_advantage(batch)
    for minibatch in SequenceMinibatches(2, num_minibatches=3, seed=0)(batch):
        assert minibatch.shape == (4, 2)
        assert loss(minibatch)["kl_approx"].item() == pytest.approx(0, abs=1e-6)
    sequences = batch.reshape(-1, 2)
    sequences["recurrent_state", "hidden"] += 1
    assert loss(sequences)["max_ratio"] != 1


def test_it_equals_the_clipped_objective_after_the_policy_moved() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network, clip_epsilon=0.1, entropy_coeff=0.02)
    loss.estimate_advantage(batch)
    network.actor.bias.data += torch.tensor([0.25, 0.0])
    unrolled = network.unroll(batch)
    log_probs = unrolled["logits"].log_softmax(-1)
    taken = log_probs.gather(-1, batch["action"].unsqueeze(-1)).squeeze(-1)
    ratio = (taken - batch["action_log_prob"]).exp()
    advantage = batch["advantage"].squeeze(-1)
    gain = torch.minimum(ratio * advantage, ratio.clamp(0.9, 1.1) * advantage)
    out = loss(batch)
    torch.testing.assert_close(out["loss_objective"], -gain.mean())
    entropy = -(log_probs.exp() * log_probs).sum(-1).mean()
    torch.testing.assert_close(out["loss_entropy"], -0.02 * entropy)
    assert 0 < out["clip_fraction"] < 1


def test_value_targets_follow_the_rule_of_bootstrapping() -> None:
    network, batch = collected_slice(rows=4, steps=7)
    loss = RecurrentPPOLoss(network).make_value_estimator(gamma=0.9, lmbda=1.0)
    loss.estimate_advantage(batch)
    following = batch["next"]
    expected = n_step_returns(
        following["reward"],
        network.next_values(batch),
        (following["done"], following["terminated"]),
        0.9,
    )
    torch.testing.assert_close(batch["value_target"], expected, atol=1e-5, rtol=1e-4)


def test_advantages_are_normalised_over_the_batch() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    raw = loss.estimate_advantage(batch.clone(), normalize=False)["advantage"]
    normal = loss.estimate_advantage(batch)["advantage"]
    assert normal.mean().item() == pytest.approx(0, abs=1e-6)
    assert normal.std(correction=0).item() == pytest.approx(1)
    correlation = torch.corrcoef(torch.stack([raw.flatten(), normal.flatten()]))[0, 1]
    assert correlation.item() == pytest.approx(1)


def test_equal_advantages_do_not_explode() -> None:
    network, batch = collected_slice(share=1.0)
    batch["next", "terminated"][:] = True
    batch["next", "reward"] = batch["state_value"].clone()
    loss = RecurrentPPOLoss(network)
    assert not loss.estimate_advantage(batch)["advantage"].any()


def test_a_batch_without_an_advantage_gets_one_and_is_left_alone() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    keys = set(batch.keys(True, True))
    out = loss(batch)
    assert set(batch.keys(True, True)) == keys
    expected = loss(loss.estimate_advantage(batch, normalize=False))
    assert out["loss_objective"] == expected["loss_objective"]


def test_gradients_reach_every_weight_in_one_pass_of_the_trunk() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    loss.estimate_advantage(batch)
    with patch.object(network.trunk, "forward", wraps=network.trunk.forward) as trunk:
        out = loss(batch)
    assert trunk.call_count == 1
    sum(out[key] for key in LOSSES).backward()
    assert all(p.grad is not None and p.grad.any() for p in network.parameters())


@pytest.mark.parametrize("key", LOSSES)
def test_each_loss_alone_reaches_the_trunk(key: str) -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    network.actor.bias.data += torch.tensor([0.1, 0.0])
    loss(loss.estimate_advantage(batch))[key].backward()
    assert network.trunk.project.weight.grad.any()


def test_the_network_stays_the_caller_s_own() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    assert set(loss.parameters()) == set(network.parameters())
    before = loss(batch)["loss_critic"]
    torch.nn.init.zeros_(network.critic.weight)
    assert loss(batch)["loss_critic"] != before


def test_weights_that_exploded_are_named() -> None:
    # Seen with lr=1e30: TorchRL samples from such a policy, which torch refuses.
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    loss.estimate_advantage(batch)
    torch.nn.init.constant_(next(network.lstm.parameters()), torch.nan)
    with pytest.raises(FloatingPointError, match="hidden state must be finite"):
        loss(batch)


def test_keys_can_be_set() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    expected = loss(batch)["loss_critic"]
    batch["next", "intrinsic_reward"] = batch["next"].pop("reward")
    loss.set_keys(reward="intrinsic_reward")
    assert loss(batch)["loss_critic"] == expected


def test_in_keys_are_all_it_reads_of_a_minibatch() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    loss.estimate_advantage(batch)
    losses = loss(batch)
    assert (loss(batch.select(*loss.in_keys)) == losses).all()
    assert set(LOSSES) | {"entropy"} <= set(losses.keys())


def test_coefficients_can_be_assigned_while_training() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network, entropy_coeff=0.01)
    before = loss(batch)["loss_entropy"]
    loss.entropy_coeff = 0.02
    torch.testing.assert_close(loss(batch)["loss_entropy"], 2 * before)


def test_what_is_missing_is_named() -> None:
    network, batch = collected_slice()
    loss = RecurrentPPOLoss(network)
    for key in ("advantage", "value_target"):
        batch.set(key, batch["state_value"])
    with pytest.raises(KeyError, match="must have 'action_log_prob', the key of sampl"):
        loss(batch.exclude("action_log_prob"))
    with pytest.raises(TypeError, match="got Linear without in_keys, num_actions, act"):
        RecurrentPPOLoss(torch.nn.Linear(2, 2))  # type: ignore[arg-type]


def test_arguments_out_of_range_are_refused() -> None:
    network, _ = collected_slice()
    with pytest.raises(ValueError, match=r"lmbda must be in \[0, 1\], got -0.1"):
        RecurrentPPOLoss(network).make_value_estimator(lmbda=-0.1)
