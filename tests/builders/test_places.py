"""The file of what views say on one map."""

from pathlib import Path

import pytest
import torch

from tests.damaged import OTHER_SIZES, OTHER_WEIGHTS, refusing, replace
from toponav.builders import PLACES_FILE, MapNetworks, load_places, save_places
from toponav.config import SettingsError
from toponav.graph.poses import BEARINGS, DISTANCES
from toponav.modules import GroundNetwork, OffsetNetwork, PlaceNetwork

SPOTS = len(BEARINGS), len(DISTANCES)
#: The names of each network's weights and sizes in a file.
PARTS = {
    "weights": (),
    "offsets": ("offsets_sizes",),
    "ground": ("ground_sizes",),
}


@pytest.fixture
def places() -> PlaceNetwork:
    torch.manual_seed(0)
    found = PlaceNetwork(5, 8, hidden=16)
    found.scale_by(torch.randn(30, 8) * 3 + 1)
    return found.eval()


@pytest.fixture
def saved(places, tmp_path: Path) -> Path:
    ground = GroundNetwork(8, *SPOTS, hidden=4)
    networks = MapNetworks(places, OffsetNetwork(5, 8, hidden=6), ground)
    save_places(networks, tmp_path / PLACES_FILE)
    return tmp_path / PLACES_FILE


def load(path: Path, number: int = 5, size: int = 8) -> MapNetworks:
    return load_places(path, num_places=number, embedding_size=size, setting="run")


def refused(path: Path, rule: str) -> None:
    with refusing(f"run must name {rule}"):
        load(path)


def test_it_loads_as_it_was(places, tmp_path: Path) -> None:
    path = tmp_path / PLACES_FILE
    ground = GroundNetwork(8, *SPOTS, hidden=4).eval()
    offsets = OffsetNetwork(5, 8, hidden=6).eval()
    for network in (ground, offsets):
        network.scale_by(torch.randn(30, 8) + 2)
    save_places(MapNetworks(places, offsets, ground), path)
    again = load(path)
    views = torch.randn(4, 8)
    for name, wanted in (("places", places), ("offsets", offsets), ("ground", ground)):
        found = getattr(again, name)
        assert not found.training
        assert torch.equal(found(views), wanted(views))


def test_one_of_an_earlier_version_has_places_alone(places, tmp_path: Path) -> None:
    save_places(MapNetworks(places), tmp_path / PLACES_FILE)
    again = load(tmp_path / PLACES_FILE)
    assert again.offsets is again.ground is None


def test_one_of_another_map_or_a_damaged_one_is_refused(places, tmp_path) -> None:
    path = tmp_path / PLACES_FILE
    save_places(MapNetworks(places), path)
    with pytest.raises(SettingsError, match="knows the 6 waypoints of its map, got 5"):
        load(path, number=6)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(SettingsError, match="run must name a complete file, got the d"):
        load(path)


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("kind", OTHER_WEIGHTS)
def test_other_weights_are_refused(saved: Path, part: str, kind: str) -> None:
    other, said = OTHER_WEIGHTS[kind]
    replace(saved, (part, "mean"), other)
    refused(saved, f"places .*places.pt .*{said}")


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("bad", OTHER_SIZES, ids=lambda bad: str(bad)[:9])
def test_sizes_that_are_no_counts_are_refused(saved: Path, part: str, bad) -> None:
    replace(saved, (*PARTS[part], "hidden"), bad)
    refused(saved, r"places saved with the same .*places.pt \(hidden must be a count ")


@pytest.mark.parametrize("part", PARTS)
def test_a_network_larger_than_its_weights_takes_no_memory(
    saved: Path, part: str
) -> None:
    # Two layers of that width would take terabytes.
    replace(saved, (*PARTS[part], "hidden"), 10**6)
    refused(saved, r"places .*0.weight is torch.float32 \[\d+, 8\], not .*\[1000000, 8")


@pytest.mark.parametrize(
    ("part", "size", "rule"),
    [
        ("offsets", "num_places", "knows the 5 waypoints of its map, got 20000"),
        ("weights", "embedding_size", "knows embeddings of 8 numbers, .*, got 20000"),
        ("offsets", "embedding_size", "knows embeddings of 8 numbers, .*, got 20000"),
        ("ground", "embedding_size", "knows embeddings of 8 numbers, .*, got 20000"),
        ("ground", "num_bearings", "knows ground at 13 bearings, got 20000"),
        ("ground", "num_distances", "knows ground at 12 distances, got 20000"),
    ],
)
def test_sizes_of_another_map_are_refused(
    saved: Path, part: str, size: str, rule: str
) -> None:
    replace(saved, (*PARTS[part], size), 20_000)
    refused(saved, f"a run whose places.pt {rule}")


def test_networks_for_other_embeddings_than_the_maps_are_refused(saved: Path) -> None:
    rule = "knows embeddings of 9 numbers, as those of its map, got 8"
    with pytest.raises(SettingsError, match=rule):
        load(saved, size=9)
