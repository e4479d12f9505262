"""The file of what views say on one map."""

from pathlib import Path

import pytest
import torch

from toponav.builders import PLACES_FILE, load_places, save_places
from toponav.config import SettingsError
from toponav.modules import GroundNetwork, PlaceNetwork


@pytest.fixture
def places() -> PlaceNetwork:
    torch.manual_seed(0)
    found = PlaceNetwork(5, 8, hidden=16)
    found.scale_by(torch.randn(30, 8) * 3 + 1)
    return found.eval()


def test_it_loads_as_it_was(places, tmp_path: Path) -> None:
    path = tmp_path / PLACES_FILE
    ground = GroundNetwork(8, 3, 2, hidden=4).eval()
    ground.scale_by(torch.randn(30, 8) + 2)
    save_places(places, path, ground)
    again, ground_again = load_places(path, num_places=5, setting="run")
    assert ground_again is not None
    views = torch.randn(4, 8)
    for found, wanted in ((again, places), (ground_again, ground)):
        assert not found.training
        assert torch.equal(found(views), wanted(views))


def test_one_of_an_earlier_version_sees_no_ground(places, tmp_path: Path) -> None:
    save_places(places, tmp_path / PLACES_FILE)
    _, ground = load_places(tmp_path / PLACES_FILE, num_places=5, setting="run")
    assert ground is None


def test_one_of_another_map_or_a_damaged_one_is_refused(places, tmp_path) -> None:
    path = tmp_path / PLACES_FILE
    save_places(places, path)
    with pytest.raises(SettingsError, match="knows the 6 waypoints of its map, got 5"):
        load_places(path, num_places=6, setting="run")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(SettingsError, match="run must name a complete file, got the d"):
        load_places(path, num_places=5, setting="run")
