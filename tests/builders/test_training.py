from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from tensordict import TensorDict

from tests.builders.models import tiny_model
from toponav.builders import (
    decisions_due,
    learning_rate,
    make_losses,
    make_networks,
    make_optimizer,
    require_finite,
    restore_training,
    save_training,
)
from toponav.config import PretrainConfig, SettingsError, TrainingError, register
from toponav.keys import ACTION, ANCHOR, LABEL, OTHER

CONF = Path(__file__).parent.parent.parent / "conf"


def settings(*overrides: str) -> PretrainConfig:
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return OmegaConf.to_object(compose("pretrain", overrides=list(overrides)))


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


@pytest.mark.parametrize("mined", [True, False])
def test_the_losses_read_what_the_pairs_are_made_of(mined: bool) -> None:
    networks = make_networks(tiny_model())
    tc_loss, l_loss = make_losses(networks, mined=mined)
    views = torch.randint(0, 256, (6, 60, 80, 3), dtype=torch.uint8)
    entry = torch.randn(6, 16) if mined else views
    pairs = TensorDict({ANCHOR: entry, OTHER: entry}, [6])
    pairs[LABEL], pairs[ACTION] = torch.ones(6), torch.zeros(6, dtype=torch.int64)
    loss = tc_loss(pairs)["loss_tc"] + l_loss(pairs)["loss_locomotion"]
    loss.backward()
    reached = {
        name for name, p in networks.modules.named_parameters() if p.grad is not None
    }
    assert any("comparator" in name for name in reached)
    assert any("head" in name for name in reached)
    assert any("encoder" in name for name in reached) != mined


def trained(model: object, steps: int):
    torch.manual_seed(0)
    networks = make_networks(model)
    optimizer = make_optimizer(networks, settings().train)
    generator = torch.Generator().manual_seed(1)
    train(networks, optimizer, generator, steps)
    return networks, optimizer, generator


def train(networks, optimizer, generator, steps: int) -> None:
    for _ in range(steps):
        views = torch.randint(
            0, 256, (4, 60, 80, 3), dtype=torch.uint8, generator=generator
        )
        optimizer.zero_grad()
        networks.tc(views, views.flip(0)).square().mean().backward()
        optimizer.step()


def test_a_restored_training_goes_on_as_if_nothing_had_happened(tmp_path: Path) -> None:
    one, optimizer, generator = trained(tiny_model(), 2)
    history = [{"update": 2, "loss_tc": 0.5}]
    save_training(tmp_path, one, optimizer, generator, update=2, history=history)
    other, optimizer_2, generator_2 = trained(tiny_model(), 1)
    found = restore_training(tmp_path, other, optimizer_2, generator_2)
    assert found == (2, history)
    train(one, optimizer, generator, 2)
    train(other, optimizer_2, generator_2, 2)
    for name, weight in one.modules.state_dict().items():
        assert torch.equal(weight, other.modules.state_dict()[name]), name


def test_a_checkpoint_of_another_model_is_refused(tmp_path: Path) -> None:
    save_training(tmp_path, *trained(tiny_model(), 0), update=0, history=[])
    wide = trained(tiny_model(embedding_dim=32), 0)
    with pytest.raises(
        SettingsError, match=r"resume .* model.embedding_dim=32, got 16"
    ):
        restore_training(tmp_path, *wide)
    torch.save({"kind": "toponav networks"}, tmp_path / "checkpoint.pt")
    with pytest.raises(SettingsError, match="a run of version 1, got"):
        restore_training(tmp_path, *wide)


def test_a_loss_that_is_no_number_is_named() -> None:
    figures = {"loss_tc": 0.7, "loss_locomotion": 1.5}
    require_finite(figures, 3, Path("run"))
    figures["loss_locomotion"] = float("nan")
    with pytest.raises(
        TrainingError,
        match=r"loss_locomotion must be finite, got nan in update 3; .*checkpoint.pt",
    ):
        require_finite(figures, 3, Path("run"))


def test_the_buffer_is_measured_in_memory() -> None:
    # 60 * 80 * 3 = 14,400 bytes halved, four times that in full.
    assert settings("collect.buffer_gb=0.144").buffer == 10_000
    full = settings("collect.buffer_gb=0.144", "model=resnet18")
    assert (full.halve, full.buffer) == (False, 2500)
    with pytest.raises(SettingsError, match=r"frames in collect.buffer_gb .* M \* k"):
        settings("collect.buffer_gb=0.001", "collect.envs=64")
