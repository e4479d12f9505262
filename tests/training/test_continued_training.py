import copy
from dataclasses import replace

import pytest
import torch
from torchrl.data import LazyTensorStorage

from tests.exploring import explore_settings
from tests.models import tiny_model
from tests.training.pair_storage import WORLD, make_walks, pair_settings
from toponav.builders import Networks, make_networks
from toponav.config import OnlineConfig
from toponav.training import ContinuedTraining

#: No number in it is a default of the settings, so that one that is not read is seen.
CONFIG = OnlineConfig(
    learn=True,
    lr=0.01,
    weight_decay=0.003,
    locomotion_coeff=0.3,
    every=40,
    publish_every=150,
    ahead=100,
    buffer_gb=1e-9,
)


def make(seed: int = 0) -> tuple[Networks, ContinuedTraining]:
    torch.manual_seed(seed)
    networks = make_networks(tiny_model(), WORLD)
    settings = replace(
        explore_settings(), online=CONFIG, pairs=pair_settings(), seed=seed
    )
    training = ContinuedTraining(settings, networks, lambda figures, update: None)
    return networks, training


def test_it_learns_by_its_own_settings() -> None:
    networks, training = make()
    (group,) = training.trainer.optimizer.param_groups
    assert (group["lr"], group["weight_decay"]) == (0.01, 0.003)
    decayed = {id(parameter) for parameter in group["params"]}
    assert decayed == {id(one) for one in networks.modules.parameters()}
    coeffs = {name: coeff for name, (_, coeff) in training.trainer.losses.items()}
    assert coeffs == {"tc": 1.0, "l": 0.3}


def test_updates_and_versions_are_due_by_decisions() -> None:
    _, training = make()
    # 60 decisions a batch: enough to begin after the second, 120 decisions.
    updates, versions, losses = [], [], []
    for number in range(4):
        losses.append(training.extend(make_walks(episodes=2, first=2 * number)))
        updates.append(training.trainer.updates)
        versions.append(training.updated())
    assert updates == [0, 1, 3, 4]
    assert versions == [(), (), ("networks",), ()]
    assert losses[0] == {}
    assert set(losses[1]) == {"loss_tc", "loss_locomotion"}


def test_the_buffer_holds_at_least_what_it_waits_for() -> None:
    _, training = make()
    storage = training.buffer.storage
    assert isinstance(storage, LazyTensorStorage)
    assert storage.max_size == CONFIG.ahead


def test_losses_are_means_over_the_updates_of_a_batch() -> None:
    (_, one), (_, other) = make(), make()
    for training in (one, other):
        training.extend(make_walks(episodes=2))
        training.extend(make_walks(episodes=2, first=2))
    steps: list[dict[str, float]] = []
    other.trainer.check = lambda figures, update: steps.append(dict(figures))
    mean = one.extend(make_walks(episodes=2, first=4))
    other.extend(make_walks(episodes=2, first=4))
    assert len(steps) == 2
    assert mean["loss_tc"] == pytest.approx(sum(s["loss_tc"] for s in steps) / 2)


def test_a_resumed_run_has_the_weights_and_the_number_of_updates() -> None:
    (whole, one), (resumed, other) = make(), make(seed=1)
    for number in range(2):
        one.extend(make_walks(episodes=2, first=2 * number))
    other.load_state_dict(copy.deepcopy(one.state_dict()))
    assert other.trainer.updates == 1
    for name, weight in whole.modules.state_dict().items():
        assert torch.equal(weight, resumed.modules.state_dict()[name]), name
