import copy
from pathlib import Path

import pytest
import torch

from tests.training.pair_storage import make_trainer
from toponav.builders import Networks
from toponav.config import TrainingError
from toponav.training import require_finite


def weights(networks: Networks) -> dict[str, torch.Tensor]:
    return copy.deepcopy(networks.modules.state_dict())


@pytest.mark.parametrize("mined", [True, False])
@pytest.mark.parametrize("share_encoder", [True, False])
def test_a_step_trains_every_parameter(mined: bool, share_encoder: bool) -> None:
    networks, trainer = make_trainer(mined=mined, share_encoder=share_encoder)
    before = weights(networks)
    measured = trainer.step()
    assert list(measured) == [
        "loss_tc",
        "loss_locomotion",
        "train_tc_accuracy",
        "train_l_accuracy",
        "gradient_norm",
    ]
    for name, weight in weights(networks).items():
        assert not torch.equal(weight, before[name]), name


def test_the_networks_are_in_train_mode_in_a_step_alone() -> None:
    networks, trainer = make_trainer()
    modes = []
    trainer.check = lambda figures, update: modes.append(networks.tc.training)
    assert not networks.tc.training
    trainer.step()
    assert modes == [True]
    assert not networks.tc.training


def test_steps_lessen_both_losses() -> None:
    _, trainer = make_trainer()
    measured = [trainer.step() for _ in range(40)]
    for name in ("loss_tc", "loss_locomotion"):
        first, last = (
            [one[name] for one in some] for some in (measured[:5], measured[-5:])
        )
        assert sum(last) < 0.9 * sum(first), name


def test_the_coefficient_weighs_the_l_network() -> None:
    networks, trainer = make_trainer(locomotion_coeff=0.0, weight_decay=0.0)
    before = weights(networks)
    trainer.step()
    changed = {
        name
        for name, weight in weights(networks).items()
        if not torch.equal(weight, before[name])
    }
    assert any("comparator" in name for name in changed)
    assert not any("head" in name for name in changed)


def test_what_the_check_refuses_changes_no_weight() -> None:
    def refuse(figures: dict[str, float], update: int) -> None:
        raise TrainingError(f"update {update}")

    networks, trainer = make_trainer(check=refuse)
    parameters = dict(networks.modules.named_parameters())
    before = {name: value.detach().clone() for name, value in parameters.items()}
    with pytest.raises(TrainingError, match="update 1"):
        trainer.step()
    for name, parameter in parameters.items():
        assert torch.equal(parameter, before[name]), name


def test_the_learning_rate_may_follow_the_updates() -> None:
    _, trainer = make_trainer(lr=lambda updates: 0.1 / (1 + updates))
    rates = []
    for _ in range(3):
        trainer.step()
        rates.append(trainer.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([0.1, 0.05, 0.1 / 3])


def test_a_trainer_continues_where_its_state_was_taken() -> None:
    (whole, one), (resumed, other) = make_trainer(), make_trainer(seed=1)
    one.step()
    other.load_state_dict(copy.deepcopy(one.state_dict()))
    assert [one.step() for _ in range(2)] == [other.step() for _ in range(2)]
    assert one.updates == other.updates == 3
    for name, weight in whole.modules.state_dict().items():
        assert torch.equal(weight, resumed.modules.state_dict()[name]), name


def test_a_loss_that_is_not_finite_is_named() -> None:
    figures = {"loss_tc": 0.7, "loss_locomotion": 1.5}
    require_finite(figures, 3, Path("run"), setting="train.lr")
    figures["loss_locomotion"] = float("nan")
    with pytest.raises(
        TrainingError,
        match=r"loss_locomotion must be finite, got nan in update 3; .*checkpoint.pt",
    ):
        require_finite(figures, 3, Path("run"), setting="train.lr")
