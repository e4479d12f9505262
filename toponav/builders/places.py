"""The file of what views say on one map: `MapNetworks`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from torch import nn

from toponav.config import require
from toponav.modules import GroundNetwork, OffsetNetwork, PlaceNetwork
from toponav.runs import reading_checkpoint, save_atomically

#: The file in a run folder that holds them.
PLACES_FILE = "places.pt"
_HEADER = {"kind": "toponav places", "version": 1}
_PLACE_SIZES = ("num_places", "embedding_size", "hidden")
_GROUND_SIZES = ("embedding_size", "num_bearings", "num_distances", "hidden")
_Module = TypeVar("_Module", bound=nn.Module)


@dataclass(frozen=True)
class MapNetworks:
    """Networks that say what a view means on one map, in ``eval()`` mode."""

    places: PlaceNetwork
    #: How far from its waypoints a view is, and where the ground before it is free;
    #: ``None`` for a map of a version that did not train them.
    offsets: OffsetNetwork | None = None
    ground: GroundNetwork | None = None


def save_places(networks: MapNetworks, path: Path) -> None:
    """Write the networks into one file, atomically."""
    # As the first version wrote it, which knew places alone.
    places = networks.places
    sizes = {name: getattr(places, name) for name in _PLACE_SIZES}
    found: dict[str, Any] = {**_HEADER, **sizes, "weights": places.state_dict()}
    for name, names in (("offsets", _PLACE_SIZES), ("ground", _GROUND_SIZES)):
        network = getattr(networks, name)
        if network is not None:
            found[f"{name}_sizes"] = {size: getattr(network, size) for size in names}
            found[name] = network.state_dict()
    save_atomically(found, path)


def load_places(path: Path, *, num_places: int, setting: str) -> MapNetworks:
    """Read what `save_places` wrote.

    An earlier version wrote no `OffsetNetwork`, and one before it no `GroundNetwork`.

    Raises:
        SettingsError: if the file that ``setting`` named is not usable, or knows
            another number of waypoints.
    """
    with reading_checkpoint(path, setting, _HEADER, "places") as state:
        given, *other = (int(state[name]) for name in _PLACE_SIZES)
        rule = f"{setting} must name a run whose {path.name} knows the {num_places} "
        require(given == num_places, f"{rule}waypoints of its map", given)
        places = PlaceNetwork(given, other[0], hidden=other[1])
        places.load_state_dict(state["weights"])
        return MapNetworks(
            places.eval(),
            _load(state, "offsets", OffsetNetwork, _PLACE_SIZES),
            _load(state, "ground", GroundNetwork, _GROUND_SIZES),
        )


def _load(
    state: dict[str, Any], name: str, kind: type[_Module], sizes: tuple[str, ...]
) -> _Module | None:
    if name not in state:
        return None
    network = kind(**{size: int(state[f"{name}_sizes"][size]) for size in sizes})
    network.load_state_dict(state[name])
    return network.eval()
