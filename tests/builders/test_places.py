"""The file of what views say on one map."""

from pathlib import Path

import pytest
import torch

from toponav.builders import PLACES_FILE, MapNetworks, load_places, save_places
from toponav.config import SettingsError
from toponav.modules import GroundNetwork, OffsetNetwork, PlaceNetwork


@pytest.fixture
def places() -> PlaceNetwork:
    torch.manual_seed(0)
    found = PlaceNetwork(5, 8, hidden=16)
    found.scale_by(torch.randn(30, 8) * 3 + 1)
    return found.eval()


def test_it_loads_as_it_was(places, tmp_path: Path) -> None:
    path = tmp_path / PLACES_FILE
    ground = GroundNetwork(8, 3, 2, hidden=4).eval()
    offsets = OffsetNetwork(5, 8, hidden=6).eval()
    for network in (ground, offsets):
        network.scale_by(torch.randn(30, 8) + 2)
    save_places(MapNetworks(places, offsets, ground), path)
    again = load_places(path, num_places=5, setting="run")
    views = torch.randn(4, 8)
    for name, wanted in (("places", places), ("offsets", offsets), ("ground", ground)):
        found = getattr(again, name)
        assert not found.training
        assert torch.equal(found(views), wanted(views))


def test_one_of_an_earlier_version_has_places_alone(places, tmp_path: Path) -> None:
    save_places(MapNetworks(places), tmp_path / PLACES_FILE)
    again = load_places(tmp_path / PLACES_FILE, num_places=5, setting="run")
    assert again.offsets is again.ground is None


def test_one_of_another_map_or_a_damaged_one_is_refused(places, tmp_path) -> None:
    path = tmp_path / PLACES_FILE
    save_places(MapNetworks(places), path)
    with pytest.raises(SettingsError, match="knows the 6 waypoints of its map, got 5"):
        load_places(path, num_places=6, setting="run")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(SettingsError, match="run must name a complete file, got the d"):
        load_places(path, num_places=5, setting="run")
