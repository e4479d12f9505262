"""An exploration can begin with the policy of another one."""

from pathlib import Path

import pytest
import torch

from tests.exploring import explore_settings, make_batch, world_of
from tests.methods import test_q_learners
from toponav.builders import Learner, save_policy
from toponav.config import SettingsError
from toponav.methods import make_reward
from toponav.runs import CHECKPOINT_FILE
from toponav.training import ExplorationState, make_learner


def first_learner(folder: Path, *words: str, seed: int = 1) -> Learner:
    torch.manual_seed(seed)
    config = explore_settings("reward=random", *words)
    world = world_of(config)
    reward = make_reward(config, world, None)
    return make_learner(config, world, reward, ExplorationState(), folder)


def first_weights(folder: Path, *words: str) -> dict[str, torch.Tensor]:
    return first_learner(folder, *words).policy.state_dict()


def require_same_copy(learner: Learner) -> None:
    """The policy and its older copy make the same of a view."""
    older = learner.loss.target_value_network_params.flatten_keys(".").values()
    newer = learner.policy.value_network.parameters()
    pairs = zip(
        sorted(older, key=torch.numel), sorted(newer, key=torch.numel), strict=True
    )
    assert all(torch.equal(one, two) for one, two in pairs)


def test_the_weights_of_the_other_run_are_the_first(tmp_path: Path) -> None:
    fresh = first_weights(tmp_path)
    kept = {name: value + 1 for name, value in fresh.items()}
    save_policy(tmp_path, kept)
    for named in (tmp_path, tmp_path / "policy.pt"):
        found = first_weights(tmp_path, f"init_policy={named}")
        assert all(bool((found[name] == kept[name]).all()) for name in kept)
    # Nor has a run of its own that was cut off before its first checkpoint.
    words = (f"init_policy={tmp_path}", f"resume={tmp_path}")
    resumed = first_weights(tmp_path, *words)
    assert all(bool((resumed[name] == kept[name]).all()) for name in kept)
    # One with a checkpoint has weights of its own, and needs the other no more.
    (tmp_path / CHECKPOINT_FILE).touch()
    words = (f"init_policy={tmp_path / 'gone'}", f"resume={tmp_path}")
    resumed = first_weights(tmp_path, *words)
    assert all(bool((resumed[name] == fresh[name]).all()) for name in fresh)


def test_the_older_copy_of_a_value_learner_gets_the_weights_too(
    tmp_path: Path,
) -> None:
    words = ("loss=dqn", "policy.input=pixels")
    save_policy(tmp_path, first_weights(tmp_path, *words))
    learner = first_learner(tmp_path, *words, f"init_policy={tmp_path}", seed=2)
    require_same_copy(learner)


@pytest.mark.parametrize("loss", ["ppo", "dqn"])
def test_a_learner_on_a_device_begins_with_them_there(
    device: str, loss: str, tmp_path: Path
) -> None:
    small = (*test_q_learners.SMALL, "policy.input=pixels")
    words = (f"loss={loss}", *(small if loss == "dqn" else ("reward=novelty",)))
    # Of a run on the processor.
    kept = {name: one + 1 for name, one in first_weights(tmp_path, *words).items()}
    save_policy(tmp_path, kept)
    words += (f"device={device}", f"init_policy={tmp_path}")
    learner = first_learner(tmp_path, *words, seed=2)
    for name, weights in learner.policy.state_dict().items():
        assert str(weights.device).startswith(device), name
        assert torch.equal(weights.cpu(), kept[name]), name
    if loss == "dqn":
        require_same_copy(learner)
        batch = test_q_learners.make_batch()
    else:
        batch = make_batch(explore_settings(*words))
    # And it learns from there on.
    assert learner.extend(batch)
    changed = learner.policy.state_dict().items()
    assert any(not torch.equal(one.cpu(), kept[name]) for name, one in changed)


def test_a_policy_of_other_settings_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(
        SettingsError, match=r"init_policy must name a run with policy.pt"
    ):
        first_weights(tmp_path, f"init_policy={tmp_path}")
    save_policy(tmp_path, first_weights(tmp_path))
    rule = "init_policy must name a policy saved with the same settings"
    with pytest.raises(SettingsError, match=rule):
        first_weights(tmp_path, f"init_policy={tmp_path}", "policy.hidden=8")
