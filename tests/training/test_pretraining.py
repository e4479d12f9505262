from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torchrl.data import LazyTensorStorage

from tests import composed
from tests.models import WORLD, tiny_model
from tests.training.pair_storage import make_trainer
from toponav.builders import make_frame_buffer
from toponav.config import PretrainConfig, SettingsError
from toponav.training import (
    decisions_due,
    learning_rate,
    restore_training,
    save_training,
)


def settings(*overrides: str) -> PretrainConfig:
    found = composed.settings("pretrain", *overrides)
    assert isinstance(found, PretrainConfig)
    return found


def test_the_learning_rate_rises_and_falls() -> None:
    train = replace(settings().train, updates=110, warmup=10, lr=1.0)
    assert learning_rate(train, 0) == pytest.approx(0.1)
    assert learning_rate(train, 9) == pytest.approx(1.0)
    assert learning_rate(train, 60) == pytest.approx(0.5)
    assert learning_rate(train, 109) < 0.001
    constant = replace(train, schedule="constant")
    assert learning_rate(constant, 109) == 1.0
    assert learning_rate(replace(train, warmup=0), 0) == 1.0


def test_decisions_are_due_by_count() -> None:
    config = settings(
        "collect.decisions=1000000",
        "collect.ahead=200000",
        "collect.share=0.5",
        "train.updates=1000",
    )
    # 200,000 before the first update, the rest over the first 500.
    due = [decisions_due(config, update) for update in (0, 250, 500, 999)]
    assert due == [200_000, 600_000, 1_000_000, 1_000_000]


def test_a_restored_training_goes_on_as_if_nothing_had_happened(tmp_path: Path) -> None:
    (one, trainer), (other, restored) = make_trainer(), make_trainer(seed=1)
    trainer.step()
    history = [{"update": 1, "loss_tc": 0.5}]
    save_training(tmp_path, one, trainer, history)
    drawn = torch.rand(1)
    torch.manual_seed(99)
    assert restore_training(tmp_path, other, restored) == history
    assert torch.equal(torch.rand(1), drawn)  # the random state too
    assert restored.updates == 1
    assert trainer.step() == restored.step()
    for name, weight in one.modules.state_dict().items():
        assert torch.equal(weight, other.modules.state_dict()[name]), name


def test_a_checkpoint_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    networks, trainer = make_trainer()
    trainer.step()
    save_training(tmp_path, networks, trainer, [])
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    state["update"] = state.pop("updates")
    torch.save(state, tmp_path / "checkpoint.pt")
    networks, trainer = make_trainer()
    restore_training(tmp_path, networks, trainer)
    assert trainer.updates == 1


def test_a_checkpoint_of_another_model_is_refused(tmp_path: Path) -> None:
    networks, trainer = make_trainer()
    save_training(tmp_path, networks, trainer, [])
    wide = replace(networks, model=tiny_model(embedding_dim=32))
    with pytest.raises(
        SettingsError, match=r"resume .* model.embedding_dim=32, got 16"
    ):
        restore_training(tmp_path, wide, trainer)
    torch.save({"kind": "toponav networks"}, tmp_path / "checkpoint.pt")
    with pytest.raises(SettingsError, match="a run of version 1, got"):
        restore_training(tmp_path, wide, trainer)


def test_a_checkpoint_without_a_part_is_refused(tmp_path: Path) -> None:
    networks, trainer = make_trainer()
    save_training(tmp_path, networks, trainer, [])
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    del state["updates"]
    torch.save(state, tmp_path / "checkpoint.pt")
    with pytest.raises(SettingsError, match="resume must name a run saved with"):
        restore_training(tmp_path, networks, trainer)


def num_frames(*overrides: str) -> int:
    storage = make_frame_buffer(settings(*overrides), WORLD).storage
    assert isinstance(storage, LazyTensorStorage)
    return int(storage.max_size)


def test_the_buffer_is_measured_in_memory() -> None:
    # 60 * 80 * 3 = 14,400 bytes halved, four times that in full.
    assert num_frames("collect.buffer_gb=0.144") == 10_000
    assert num_frames("collect.buffer_gb=0.144", "model=resnet18") == 2500
    with pytest.raises(SettingsError, match=r"frames in collect.buffer_gb .* M \* k"):
        num_frames("collect.buffer_gb=0.001", "collect.envs=64")
