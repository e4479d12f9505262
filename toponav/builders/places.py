"""The file of what views say on one map: `MapNetworks`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from toponav.config import require
from toponav.graph.poses import BEARINGS, DISTANCES
from toponav.modules import GroundNetwork, OffsetNetwork, PlaceNetwork
from toponav.runs import (
    load_weights,
    read_counts,
    reading_checkpoint,
    save_atomically,
)

#: The file in a run folder that holds them.
PLACES_FILE = "places.pt"
_HEADER = {"kind": "toponav places", "version": 1}
_PLACE_SIZES = ("num_places", "embedding_size", "hidden")
_GROUND_SIZES = ("embedding_size", "num_bearings", "num_distances", "hidden")
#: What each of these sizes counts.
_KNOWN = {
    "num_places": "the {} waypoints of its map",
    "embedding_size": "embeddings of {} numbers, as those of its map",
    "num_bearings": "ground at {} bearings",
    "num_distances": "ground at {} distances",
}


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


def load_places(
    path: Path, *, num_places: int, embedding_size: int, setting: str
) -> MapNetworks:
    """Read what `save_places` wrote for a map's waypoints and their embeddings.

    An earlier version wrote no `OffsetNetwork`, and one before it no `GroundNetwork`.

    Raises:
        SettingsError: if the file that ``setting`` named is not usable, or is of
            another map: it has other weights than such networks, or knows another
            number of waypoints, embeddings of another size or other ground.
    """
    wanted = {"num_places": num_places, "embedding_size": embedding_size}
    wanted |= {"num_bearings": len(BEARINGS), "num_distances": len(DISTANCES)}
    rule = f"{setting} must name a run whose {path.name} knows"

    def sizes(found: dict[str, Any], names: tuple[str, ...]) -> dict[str, int]:
        counts = read_counts(found, names)
        for name, known in _KNOWN.items():
            if name in counts:
                must = f"{rule} {known.format(wanted[name])}"
                require(counts[name] == wanted[name], must, counts[name])
        return counts

    offsets, ground = None, None
    with reading_checkpoint(path, setting, _HEADER, "places") as state:
        make = partial(PlaceNetwork, **sizes(state, _PLACE_SIZES))
        places = load_weights(make, state["weights"])
        if "offsets" in state:
            own = sizes(state["offsets_sizes"], _PLACE_SIZES)
            offsets = load_weights(partial(OffsetNetwork, **own), state["offsets"])
        if "ground" in state:
            own = sizes(state["ground_sizes"], _GROUND_SIZES)
            ground = load_weights(partial(GroundNetwork, **own), state["ground"])
    return MapNetworks(places, offsets, ground)
