"""The file of what views say on one map: its `PlaceNetwork` and `GroundNetwork`."""

from pathlib import Path

from toponav.config import require
from toponav.modules import GroundNetwork, PlaceNetwork
from toponav.runs import reading_checkpoint, save_atomically

#: The file in a run folder that holds them.
PLACES_FILE = "places.pt"
_HEADER = {"kind": "toponav places", "version": 1}
_SIZES = ("num_places", "embedding_size", "hidden")
_GROUND_SIZES = ("embedding_size", "num_bearings", "num_distances", "hidden")


def save_places(
    places: PlaceNetwork, path: Path, ground: GroundNetwork | None = None
) -> None:
    """Write the networks into one file, atomically."""
    sizes: dict[str, object] = {name: getattr(places, name) for name in _SIZES}
    found = {**_HEADER, **sizes, "weights": places.state_dict()}
    if ground is not None:
        found["ground_sizes"] = {name: getattr(ground, name) for name in _GROUND_SIZES}
        found["ground"] = ground.state_dict()
    save_atomically(found, path)


def load_places(
    path: Path, *, num_places: int, setting: str
) -> tuple[PlaceNetwork, GroundNetwork | None]:
    """Read what `save_places` wrote, in ``eval()`` mode.

    An earlier version wrote no `GroundNetwork`.

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
        ground = None
        if "ground" in state:
            sizes = {name: int(state["ground_sizes"][name]) for name in _GROUND_SIZES}
            ground = GroundNetwork(**sizes)
            ground.load_state_dict(state["ground"])
            ground.eval()
    return places.eval(), ground
