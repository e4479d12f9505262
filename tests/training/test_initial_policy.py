"""An exploration can begin with the policy of another one."""

from pathlib import Path

import pytest
import torch

from tests.exploring import explore_settings, world_of
from toponav.builders import save_policy
from toponav.config import SettingsError
from toponav.methods import make_reward
from toponav.runs import CHECKPOINT_FILE
from toponav.training import ExplorationState, make_learner


def first_weights(folder: Path, *words: str) -> dict[str, torch.Tensor]:
    torch.manual_seed(1)
    config = explore_settings("reward=random", *words)
    world = world_of(config)
    reward = make_reward(config, world, None)
    learner = make_learner(config, world, reward, ExplorationState(), folder)
    return learner.policy.state_dict()


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
    torch.manual_seed(2)
    config = explore_settings("reward=random", *words, f"init_policy={tmp_path}")
    world = world_of(config)
    reward = make_reward(config, world, None)
    learner = make_learner(config, world, reward, ExplorationState(), tmp_path)
    # What the policy and its older copy make of a view.
    older = learner.loss.target_value_network_params.flatten_keys(".").values()
    newer = learner.policy.value_network.parameters()
    pairs = zip(
        sorted(older, key=torch.numel), sorted(newer, key=torch.numel), strict=True
    )
    assert all(torch.equal(one, two) for one, two in pairs)


def test_a_policy_of_other_settings_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(
        SettingsError, match=r"init_policy must name a run with policy.pt"
    ):
        first_weights(tmp_path, f"init_policy={tmp_path}")
    save_policy(tmp_path, first_weights(tmp_path))
    rule = "init_policy must name a policy saved with the same settings"
    with pytest.raises(SettingsError, match=rule):
        first_weights(tmp_path, f"init_policy={tmp_path}", "policy.hidden=8")
