"""The file of an explorer's policy."""

from pathlib import Path

import pytest
import torch
from torch import nn

from tests.damaged import OTHER_WEIGHTS, refusing, replace
from toponav.builders import load_new_policy, load_policy, save_policy
from toponav.config import SettingsError


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    save_policy(tmp_path, nn.Linear(4, 3).state_dict())
    return tmp_path / "policy.pt"


def test_it_loads_as_it_was(saved: Path) -> None:
    wanted = torch.load(saved, weights_only=True)["weights"]
    found = nn.Linear(4, 3)
    load_policy(saved, found)
    made = load_new_policy(saved.parent, lambda: nn.Linear(4, 3), setting="n")
    for policy in (found, made):
        assert torch.equal(policy.weight, wanted["weight"])
        assert torch.equal(policy.bias, wanted["bias"])


@pytest.mark.parametrize("kind", OTHER_WEIGHTS)
def test_other_weights_are_refused(saved: Path, kind: str) -> None:
    other, said = OTHER_WEIGHTS[kind]
    replace(saved, ("weights", "weight"), other)
    policy = nn.Linear(4, 3)
    before = policy.weight.clone()
    with refusing(f"init_policy must name a policy .*policy.pt .*{said}"):
        load_policy(saved, policy)
    assert torch.equal(policy.weight, before)


def test_one_larger_than_its_weights_is_never_made(saved: Path) -> None:
    made = []

    def make() -> nn.Module:
        policy = nn.Linear(10**6, 10**6)  # terabytes
        made.append(policy.weight.device.type)
        return policy

    rule = r"^n must name a policy saved .*\(weight is torch.float32 \[3, 4\], not "
    with pytest.raises(SettingsError, match=rule):
        load_new_policy(saved, make, setting="n")
    assert made == ["meta"]
