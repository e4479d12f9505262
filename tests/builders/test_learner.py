import copy
from pathlib import Path

import pytest
import torch

from tests.builders.exploring import explore_settings, make_batch
from toponav.builders import (
    ExplorationState,
    Learner,
    make_actor_critic,
    save_exploration,
    start_exploration,
)
from toponav.builders.learner import falling
from toponav.builders.map_growth import NoMap
from toponav.builders.walks import NoWalks
from toponav.config import SettingsError, TrainingError
from toponav.objectives import A3CLoss, SharedRMSProp

BOTH = pytest.mark.parametrize(
    "overrides",
    [("loss=ppo",), ("loss=a3c", "loss.normalize_returns=false")],
    ids=["ppo", "a3c"],
)


def unchecked(figures: dict[str, float], update: int) -> None:
    pass


def make_learner(*overrides: str, seed: int = 0) -> Learner:
    config = explore_settings(*overrides)
    torch.manual_seed(seed)
    return Learner(config, make_actor_critic(config), check=unchecked)


def weights(learner: Learner) -> torch.Tensor:
    return torch.cat([one.detach().flatten() for one in learner.policy.parameters()])


@BOTH
def test_a_learner_that_was_saved_goes_on_exactly(
    overrides: tuple[str, ...], tmp_path: Path
) -> None:
    config = explore_settings(*overrides)
    whole, other = make_learner(*overrides), make_learner(*overrides, seed=1)
    whole.learn(make_batch(config, seed=0), 0.1)
    state = ExplorationState(decisions=128, history=[{"decisions": 128}])
    save_exploration(tmp_path, state, whole, None, NoMap(), NoWalks())
    torch.manual_seed(99)
    found = start_exploration(tmp_path, other, None, NoMap(), NoWalks(), resume=True)
    assert found == state
    for seed in (1, 2):
        batch = make_batch(config, seed=seed)
        told = [one.learn(batch.clone(), 0.5) for one in (whole, other)]
        assert told[0] == told[1]
    assert torch.equal(weights(whole), weights(other))
    assert whole.updates == other.updates


@BOTH
def test_learning_changes_all_of_the_network(overrides: tuple[str, ...]) -> None:
    learner = make_learner(*overrides)
    before = copy.deepcopy(learner.policy)
    learner.learn(make_batch(explore_settings(*overrides)), 0.0)
    for (name, old), new in zip(
        before.named_parameters(), learner.policy.parameters(), strict=True
    ):
        assert not torch.equal(old, new), name


def test_the_rate_and_the_entropy_bonus_fall() -> None:
    learner = make_learner("loss.lr=0.01", "loss.final_lr=0.0")
    batch = make_batch(explore_settings())
    learner.learn(batch, 0.25)
    assert learner.lr == pytest.approx(0.0075)
    # 0.01 falls to a tenth: 0.01 * (1 - 0.9 * 0.25)
    assert float(learner.loss.entropy_coeff) == pytest.approx(0.00775)
    old = weights(learner).clone()
    learner.learn(batch, 1.0)
    assert learner.lr == 0.0
    assert torch.equal(old, weights(learner))


def test_a_coefficient_never_leaves_its_range() -> None:
    found = [falling(0.2, progress) for progress in (-1, 0, 1, 2)]
    assert found == pytest.approx([1, 1, 0.2, 0.2])


def test_the_settings_name_loss_and_optimiser() -> None:
    learner = make_learner("loss=a3c", "loss.eps=0.25", "loss.gamma=0.5")
    assert isinstance(learner.loss, A3CLoss)
    assert learner.loss.gamma == 0.5
    assert isinstance(learner.optimizer, SharedRMSProp)
    assert learner.optimizer.param_groups[0]["eps"] == 0.25


def test_a_loss_that_is_no_number_stops_before_the_weights_change() -> None:
    def check(figures: dict[str, float], update: int) -> None:
        if any(value != value for value in figures.values()):
            raise TrainingError(f"{sorted(figures)} in {update}")

    config = explore_settings()
    learner = Learner(config, make_actor_critic(config), check=check)
    before = weights(learner).clone()
    batch = make_batch(config)
    batch["next", "intrinsic_reward"][0, 3] = torch.nan
    with pytest.raises(TrainingError, match="loss_objective"):
        learner.learn(batch, 0.0)
    assert torch.equal(before, weights(learner))


def test_the_best_policy_is_the_one_that_was_paid_best() -> None:
    state, policy = ExplorationState(), torch.nn.Linear(1, 1)

    def episode(paid: float, version: int = 0) -> dict[str, float]:
        return {"intrinsic_return": paid, "networks_version": version}

    def consider(weight: float, paid: float) -> bool:
        torch.nn.init.constant_(policy.weight, weight)
        state.episodes.append(episode(paid, state.networks_version))
        return state.consider(policy, "intrinsic_return", 2)

    # Means of the last two: none yet, 2, 3, 2.5
    told = [consider(w, paid) for w, paid in ((1, 1), (2, 3), (3, 3), (4, 2))]
    assert told == [False, True, True, False]
    assert state.best_return == 3
    assert state.best_policy is not None
    assert state.best_policy["weight"].item() == 3
    # Returns of another version of the networks do not compare.
    state.networks_version = 1
    assert [consider(5, 1), consider(6, 1)] == [False, True]
    assert (state.best_return, state.best_version) == (1, 1)


def test_a_run_ends_by_decisions_or_by_the_clock() -> None:
    config = explore_settings("collect.decisions=1000", "collect.minutes=2").collect
    assert ExplorationState(decisions=250, seconds=30).progress(config) == 0.25
    assert ExplorationState(decisions=250, seconds=90).progress(config) == 0.75
    assert ExplorationState(decisions=2000).progress(config) == 1


def test_a_checkpoint_of_another_policy_is_refused(tmp_path: Path) -> None:
    save_exploration(
        tmp_path, ExplorationState(), make_learner(), None, NoMap(), NoWalks()
    )
    other = make_learner("policy.hidden=8")
    with pytest.raises(SettingsError, match="checkpoint fits its settings, got"):
        start_exploration(tmp_path, other, None, NoMap(), NoWalks(), resume=True)
    assert (
        start_exploration(
            tmp_path, other, None, NoMap(), NoWalks(), resume=False
        ).decisions
        == 0
    )
