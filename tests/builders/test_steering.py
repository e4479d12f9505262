"""The file of what a practice has learned about steering."""

from pathlib import Path
from typing import Any

import pytest
import torch

from tests.damaged import OTHER_SIZES, OTHER_WEIGHTS, refusing, replace
from toponav.builders import load_controller, make_controller, save_controller
from toponav.builders.steering import CONTROLLER_FILE
from toponav.config import SettingsError
from toponav.modules import SteeringNetwork


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    save_controller(make_controller(8, 6), tmp_path)
    return tmp_path / CONTROLLER_FILE


def load(path: Path, size: int = 8) -> SteeringNetwork:
    given: dict[str, Any] = {"embedding_size": size, "num_actions": 6}
    return load_controller(path.parent, **given, setting="n")


def refused(path: Path, rule: str) -> None:
    with refusing(f"n must name a {rule}"):
        load(path)


def test_it_loads_as_it_was(saved: Path) -> None:
    found, wanted = load(saved), torch.load(saved, weights_only=True)["weights"]
    assert not found.training
    for name, weight in found.state_dict().items():
        assert torch.equal(weight, wanted[name]), name


def test_one_for_other_embeddings_is_refused(saved: Path) -> None:
    rule = r"n must name a practice with networks and actions as the run's, .*'embeddi"
    with pytest.raises(SettingsError, match=rf"{rule}ng_size': 9,.*, got .*size': 8,"):
        load(saved, size=9)


@pytest.mark.parametrize("kind", OTHER_WEIGHTS)
def test_other_weights_are_refused(saved: Path, kind: str) -> None:
    other, said = OTHER_WEIGHTS[kind]
    replace(saved, ("weights", "norm.weight"), other)
    refused(saved, f"controller .*controller.pt .*{said}")


@pytest.mark.parametrize("bad", OTHER_SIZES, ids=lambda bad: str(bad)[:9])
def test_sizes_that_are_no_counts_are_refused(saved: Path, bad: object) -> None:
    rule = "controller saved with the same settings, got .*"
    replace(saved, ("sizes", "num_actions"), bad)
    refused(saved, rf"{rule}\(num_actions must be a count ")
    replace(saved, ("sizes",), bad)
    refused(saved, rule)


def test_sizes_of_another_practice_are_refused(saved: Path) -> None:
    replace(saved, ("sizes", "hidden"), 10**6)
    refused(saved, "practice with networks and actions .*, got .*'hidden': 1000000}$")
