"""The file of a `PlaceNetwork`: saved beside the map whose waypoints it knows."""

from pathlib import Path

from toponav.config import require
from toponav.modules import PlaceNetwork
from toponav.runs import reading_checkpoint, save_atomically

#: The file in a run folder that holds it.
PLACES_FILE = "places.pt"
_HEADER = {"kind": "toponav places", "version": 1}
_SIZES = ("num_places", "embedding_size", "hidden")


def save_places(places: PlaceNetwork, path: Path) -> None:
    """Write the network into one file, atomically."""
    sizes: dict[str, object] = {name: getattr(places, name) for name in _SIZES}
    weights = places.state_dict()
    save_atomically({**_HEADER, **sizes, "weights": weights}, path)


def load_places(path: Path, *, num_places: int, setting: str) -> PlaceNetwork:
    """Read what `save_places` wrote, in ``eval()`` mode.

    Raises:
        SettingsError: if the file that ``setting`` named is not usable, or knows
            another number of waypoints.
    """
    with reading_checkpoint(path, setting, _HEADER, "places") as state:
        given, *other = (int(state[name]) for name in _SIZES)
        rule = f"{setting} must name a run whose {path.name} knows the {num_places} "
        require(given == num_places, f"{rule}waypoints of its map", given)
        places = PlaceNetwork(given, other[0], hidden=other[1])
        places.load_state_dict(state["weights"])
    return places.eval()
