"""PPO, A3C and TRPO as learners of an exploration."""

import copy
import math
from collections.abc import Mapping

import pytest
import torch

from tests.exploring import explore_settings, make_batch, world_of
from toponav.config import SettingsError, TrainingError
from toponav.keys import INTRINSIC_REWARD
from toponav.methods import LEARNERS, ActorCriticLearner
from toponav.methods.learners.actor_critic import linear_decay
from toponav.objectives import A3CLoss, SharedRMSProp

ALL = pytest.mark.parametrize(
    "overrides",
    [
        ("loss=ppo",),
        ("loss=ppo", "policy.layers=2"),
        ("loss=a3c", "loss.normalize_returns=false"),
        ("loss=trpo", "loss.rollout=32", "loss.critic_minibatches=4"),
    ],
    ids=["ppo", "ppo of two layers", "a3c", "trpo"],
)


def unchecked(figures: Mapping[str, float], update: int) -> None:
    pass


def make_learner(
    *overrides: str, seed: int = 0, progress: float = 0.0, check=unchecked
) -> ActorCriticLearner:
    config = explore_settings(*overrides)
    torch.manual_seed(seed)
    return LEARNERS[config.loss.name](
        config,
        world_of(config),
        reward=INTRINSIC_REWARD,
        check=check,
        progress=lambda: progress,
    )


def weights(learner: ActorCriticLearner) -> torch.Tensor:
    return torch.cat([one.detach().flatten() for one in learner.policy.parameters()])


@ALL
def test_a_learner_that_was_saved_continues_exactly(overrides: tuple[str, ...]) -> None:
    config = explore_settings(*overrides)
    whole, other = make_learner(*overrides), make_learner(*overrides, seed=1)
    whole.extend(make_batch(config, seed=0))
    other.load_state_dict(copy.deepcopy(whole.state_dict()))
    for seed in (1, 2):
        batch = make_batch(config, seed=seed)
        measured = [one.extend(batch.clone()) for one in (whole, other)]
        assert measured[0] == measured[1]
    assert torch.equal(weights(whole), weights(other))
    assert whole.updates == other.updates


@ALL
def test_learning_changes_all_of_the_network(overrides: tuple[str, ...]) -> None:
    learner = make_learner(*overrides)
    before = copy.deepcopy(learner.policy)
    learner.extend(make_batch(explore_settings(*overrides)))
    for (name, old), new in zip(
        before.named_parameters(), learner.policy.parameters(), strict=True
    ):
        assert not torch.equal(old, new), name


@ALL
def test_a_batch_with_only_the_keys_it_asks_for_is_enough(
    overrides: tuple[str, ...],
) -> None:
    learner = make_learner(*overrides)
    batch = make_batch(explore_settings(*overrides))
    learner.extend(batch.select(*learner.in_keys, "env_id"))


def test_the_learning_rate_and_the_entropy_bonus_fall() -> None:
    words = ("loss.lr=0.01", "loss.final_lr=0.0")
    learner = make_learner(*words, progress=0.25)
    batch = make_batch(explore_settings())
    assert learner.extend(batch)["lr"] == pytest.approx(0.0075)
    # 0.01 falls to a tenth: 0.01 * (1 - 0.9 * 0.25)
    assert float(learner.loss.entropy_coeff) == pytest.approx(0.00775)
    over = make_learner(*words, progress=1.0)
    old = weights(over).clone()
    assert over.extend(batch)["lr"] == 0.0
    assert torch.equal(old, weights(over))


@ALL
def test_rewards_that_are_not_scaled_may_go_without_discount(
    overrides: tuple[str, ...],
) -> None:
    checked: list[float] = []

    def check(figures: Mapping[str, float], update: int) -> None:
        checked.extend(figures.values())

    words = (*overrides, "loss.gamma=1", "loss.normalize_returns=false")
    learner = make_learner(*words, check=check)
    before = weights(learner)
    learner.extend(make_batch(explore_settings(*words)))
    assert math.isfinite(sum(checked))
    assert not torch.equal(before, weights(learner))


def test_a_coefficient_never_leaves_its_range() -> None:
    found = [linear_decay(0.2, progress) for progress in (-1, 0, 1, 2)]
    assert found == pytest.approx([1, 1, 0.2, 0.2])


def test_the_settings_name_loss_and_optimiser() -> None:
    learner = make_learner("loss=a3c", "loss.eps=0.25", "loss.gamma=0.5")
    assert isinstance(learner.loss, A3CLoss)
    assert learner.loss.value_estimator.gamma == 0.5
    assert isinstance(learner.optimizer, SharedRMSProp)
    assert learner.optimizer.param_groups[0]["eps"] == 0.25


def test_a_loss_that_is_not_finite_stops_before_the_weights_change() -> None:
    def check(figures: Mapping[str, float], update: int) -> None:
        if any(value != value for value in figures.values()):
            raise TrainingError(f"{sorted(figures)} in {update}")

    learner = make_learner(check=check)
    before = weights(learner).clone()
    batch = make_batch(explore_settings())
    batch["next", "intrinsic_reward"][0, 3] = torch.nan
    with pytest.raises(TrainingError, match="loss_objective"):
        learner.extend(batch)
    assert torch.equal(before, weights(learner))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["loss.gamma=2"], r"loss.gamma must lie in \[0, 1\], got 2 \(did you mean 1"),
        (["loss.gamma=1"], "loss.gamma must be below 1 with loss.normalize_returns"),
        (["loss.lr=0"], "loss.lr must be above 0, got 0"),
        (
            ["loss.rollout=40"],
            r"multiple of loss.sequence=16, got 40 \(did you mean 32",
        ),
        # 4 environments of 32 decisions make 8 sequences of 16.
        (["loss.minibatches=9"], "loss.minibatches must be at most 8, the sequences"),
        (["loss=a3c", "loss.decay=2"], r"loss.decay must lie in \[0, 1\], got 2"),
        (["loss=trpo", "loss.max_kl=0"], "loss.max_kl must be above 0, got 0"),
        (["loss=trpo", "loss.critic_minibatches=999", "loss.rollout=8"], "at most 32,"),
        (["loss=a3c", "loss.eps=0"], "loss.eps must be above 0, got 0"),
    ],
)
def test_settings_out_of_range_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        explore_settings(*words)


def test_a_narrow_clip_lets_the_policy_change_less() -> None:
    """How far PPO's updates of one batch move the probabilities of its actions."""

    def moved(clip: float) -> float:
        words = ("loss=ppo", "loss.lr=0.01", f"loss.clip_epsilon={clip}")
        batch = make_batch(explore_settings(*words))
        learner = make_learner(*words)
        before = learner.policy(batch.clone())["action_log_prob"]
        learner.extend(batch.clone())
        ratio = (learner.policy(batch.clone())["action_log_prob"] - before).exp()
        return float((ratio - 1).abs().mean())

    assert moved(0.01) < 0.8 * moved(0.5)


def test_trpo_keeps_its_bound_and_its_critic_is_a_head() -> None:
    words = ("loss=trpo", "loss.rollout=32", "loss.critic_minibatches=4")
    moved = {}
    for bound in (1e-4, 1e-2):
        learner = make_learner(*words, f"loss.max_kl={bound}")
        own = learner.loss.policy_parameters()
        before = [one.detach().clone() for one in own]
        measured = learner.extend(make_batch(explore_settings(*words)))
        assert 0 < measured["kl"] <= bound
        assert measured["loss_objective"] < 0 < measured["step_share"] <= 1
        steps = [(one - old).norm() for one, old in zip(own, before, strict=True)]
        moved[bound] = float(torch.stack(steps).norm())
    assert moved[1e-2] > 5 * moved[1e-4]
    # The critic's passes touch nothing that the policy reads.
    learner = make_learner(*words)
    batch = learner.loss.prepare(learner.scale(make_batch(explore_settings(*words))))
    old = copy.deepcopy(learner.policy)
    for piece in learner.minibatches(batch):
        learner.descend(learner.loss.critic_loss(piece), {})
    changed = {
        name.split(".")[0]
        for name, value in learner.policy.named_parameters()
        if not torch.equal(value, old.get_parameter(name))
    }
    assert changed == {"critic"}


def test_trpo_stays_as_it_is_until_there_is_a_reward() -> None:
    words = ("loss=trpo", "loss.rollout=32", "loss.critic_minibatches=4")
    config, learner = explore_settings(*words), make_learner(*words)
    before = weights(learner).clone()
    for seed in range(2):
        batch = make_batch(config, seed=seed)
        batch["next", INTRINSIC_REWARD].zero_()
        assert learner.extend(batch)["kl"] == 0
    assert torch.equal(before, weights(learner))
    assert learner.extend(make_batch(config))["kl"] > 0


def test_trpo_stops_at_a_reward_that_is_not_finite() -> None:
    def check(figures: Mapping[str, float], update: int) -> None:
        if any(value != value for value in figures.values()):
            raise TrainingError(f"{sorted(figures)} in {update}")

    words = ("loss=trpo", "loss.rollout=32", "loss.critic_minibatches=4")
    learner = make_learner(*words, check=check)
    before = weights(learner).clone()
    batch = make_batch(explore_settings(*words))
    batch["next", "intrinsic_reward"][0, 3] = torch.nan
    with pytest.raises(TrainingError, match="loss_objective"):
        learner.extend(batch)
    assert torch.equal(before, weights(learner))


def test_layers_of_the_memory_are_a_setting() -> None:
    policies = [make_learner(f"policy.layers={n}").policy for n in (1, 2)]
    one, two = (policy.initial_state(3)["hidden"].shape[-1] for policy in policies)
    assert two == 2 * one
    # The weights of a second layer of 16: 4 x 16 x (16 + 16) and two biases of 4 x 16.
    sizes = [sum(p.numel() for p in policy.lstm.parameters()) for policy in policies]
    assert sizes[1] - sizes[0] == 2048 + 128
