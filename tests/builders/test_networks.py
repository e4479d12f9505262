import pickle
from pathlib import Path

import pytest
import torch

from tests.builders.models import tiny_model
from toponav.builders import load_networks, make_networks, save_networks, start_networks
from toponav.config import SettingsError
from toponav.modules import (
    ConcatComparator,
    DifferenceComparator,
    ResNet18,
    SmallEncoder,
)

VIEWS = torch.randint(0, 256, (3, 60, 80, 3), dtype=torch.uint8)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    networks = make_networks(tiny_model())
    networks.thresholds = {"tc_threshold": 0.9}
    save_networks(networks, tmp_path / "networks.pt")
    return tmp_path / "networks.pt"


def test_every_choice_of_the_settings_is_made() -> None:
    networks = make_networks(tiny_model(comparator="concat", share_encoder=False))
    assert isinstance(networks.tc.comparator, ConcatComparator)
    assert networks.tc.encoder is not networks.locomotion.encoder
    networks = make_networks(tiny_model())
    assert isinstance(networks.tc.comparator, DifferenceComparator)
    assert isinstance(networks.tc.encoder, SmallEncoder)
    assert networks.tc.encoder is networks.locomotion.encoder
    networks = make_networks(tiny_model(encoder="resnet18", share_encoder=False))
    assert isinstance(networks.locomotion.encoder, ResNet18)


def test_a_shared_encoder_counts_once() -> None:
    def count(*, shared: bool) -> int:
        networks = make_networks(tiny_model(share_encoder=shared))
        return sum(p.numel() for p in networks.modules.parameters())

    encoder = sum(p.numel() for p in SmallEncoder(16).parameters())
    assert count(shared=False) - count(shared=True) == encoder


@pytest.mark.parametrize("share_encoder", [True, False])
def test_what_was_saved_is_what_is_loaded(tmp_path: Path, share_encoder: bool) -> None:
    networks = make_networks(tiny_model(share_encoder=share_encoder))
    networks.tc(VIEWS, VIEWS)  # moves the statistics of batch normalisation
    networks.thresholds = {"tc_threshold": 0.9, "tc_reach": 0.7}
    save_networks(networks, tmp_path / "networks.pt")
    loaded = load_networks(tmp_path)  # the folder will do
    networks.modules.eval()
    assert loaded.model == networks.model
    assert loaded.thresholds == networks.thresholds
    assert not loaded.tc.training
    assert torch.equal(loaded.tc.embed(VIEWS), networks.tc.embed(VIEWS))
    assert torch.equal(
        loaded.locomotion(VIEWS, VIEWS), networks.locomotion(VIEWS, VIEWS)
    )


def test_training_starts_where_an_earlier_one_ended(saved: Path) -> None:
    earlier = load_networks(saved)
    networks = start_networks(tiny_model(), str(saved))
    assert networks.tc.training
    for name, weight in networks.modules.state_dict().items():
        assert torch.equal(weight, earlier.modules.state_dict()[name]), name


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"must name a run with networks.pt, got"):
        load_networks(tmp_path)
    with pytest.raises(SettingsError, match=r"must name a run with none.pt, got"):
        load_networks(tmp_path / "none.pt")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_file_that_was_cut_off_is_refused(saved: Path, share: float) -> None:
    whole = saved.read_bytes()
    saved.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(SettingsError, match=r"networks must .* got the damaged"):
        load_networks(saved)


def test_no_code_in_a_file_is_run(tmp_path: Path) -> None:
    path = tmp_path / "networks.pt"
    path.write_bytes(pickle.dumps(Path("/")))
    with pytest.raises(SettingsError, match="got the damaged"):
        load_networks(path)
    torch.save(torch.zeros(2), path)
    with pytest.raises(SettingsError, match=r"file of this package, got .* Tensor"):
        load_networks(path)
    torch.save({"weights": {}}, path)
    with pytest.raises(SettingsError, match=r"networks of version 1, got .* something"):
        load_networks(path)


def test_other_weights_than_the_model_has_are_refused(saved: Path) -> None:
    state = torch.load(saved, weights_only=True)
    state["model"]["embedding_dim"] = 17
    torch.save(state, saved)
    with pytest.raises(SettingsError, match="whose weights fit their model"):
        load_networks(saved)


def test_networks_of_another_model_are_refused(saved: Path) -> None:
    with pytest.raises(
        SettingsError, match=r"init_from .* model.comparator=concat, got difference"
    ):
        start_networks(tiny_model(comparator="concat"), str(saved))
