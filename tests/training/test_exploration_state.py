from pathlib import Path

import pytest
import torch

from tests.exploring import explore_settings, make_batch
from tests.methods.test_learners import make_learner
from toponav.config import SettingsError
from toponav.training import (
    ExplorationState,
    restore_exploration,
    save_exploration,
)


def progress_after(decisions: int, seconds: float) -> float:
    state = ExplorationState()
    collect = explore_settings("collect.decisions=1000", "collect.minutes=2").collect
    state.count(decisions, seconds, collect)
    return state.progress


def test_a_run_ends_by_decisions_or_by_the_clock() -> None:
    assert progress_after(250, 30) == 0.25
    assert progress_after(250, 90) == 0.75
    assert progress_after(2000, 0) == 1


def test_what_was_saved_is_restored(tmp_path: Path) -> None:
    whole, other = make_learner(), make_learner(seed=1)
    whole.extend(make_batch(explore_settings()))
    state = ExplorationState(decisions=128, history=[{"decisions": 128}])
    state.versions["policy"] = 3
    save_exploration(tmp_path, state, {"learner": whole})
    drawn = torch.rand(1)
    torch.manual_seed(99)
    found = ExplorationState()
    restore_exploration(tmp_path, found, {"learner": other})
    assert found == state
    assert torch.equal(torch.rand(1), drawn)  # the random state too
    batch = make_batch(explore_settings(), seed=1)
    assert whole.extend(batch.clone()) == other.extend(batch)


def test_a_run_without_a_checkpoint_begins_at_its_start(tmp_path: Path) -> None:
    state = ExplorationState()
    restore_exploration(tmp_path, state, {})
    assert state == ExplorationState()


def test_a_checkpoint_of_another_policy_is_refused(tmp_path: Path) -> None:
    save_exploration(tmp_path, ExplorationState(), {"learner": make_learner()})
    other = make_learner("policy.hidden=8")
    with pytest.raises(SettingsError, match="saved with the same settings, got"):
        restore_exploration(tmp_path, ExplorationState(), {"learner": other})


def test_a_checkpoint_of_an_earlier_version_is_refused(tmp_path: Path) -> None:
    torch.save(
        {"kind": "toponav exploration", "version": 1}, tmp_path / "checkpoint.pt"
    )
    with pytest.raises(SettingsError, match=r"an exploration of version 2, got .* 1$"):
        restore_exploration(tmp_path, ExplorationState(), {})
