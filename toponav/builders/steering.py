"""The file of a `SteeringNetwork`, in the folder of a practice."""

from functools import partial
from pathlib import Path

import torch

from toponav.config import require
from toponav.graph import SteeringSenses
from toponav.modules import SteeringNetwork
from toponav.runs import (
    load_weights,
    read_counts,
    reading_checkpoint,
    save_atomically,
)

#: The file in a run folder that holds it.
CONTROLLER_FILE = "controller.pt"
_HEADER = {"kind": "toponav controller", "version": 1}


def make_controller(embedding_size: int, num_actions: int) -> SteeringNetwork:
    """One that has not practised yet, for embeddings of ``embedding_size`` numbers."""
    senses = SteeringSenses.size(num_actions)
    return SteeringNetwork(embedding_size, senses, num_actions)


def save_controller(network: SteeringNetwork, folder: Path) -> None:
    """Write ``controller.pt``, atomically."""
    weights = network.state_dict()
    state = {**_HEADER, "sizes": network.sizes, "weights": weights}
    save_atomically(state, folder / CONTROLLER_FILE)


def load_controller(
    folder: Path, *, embedding_size: int, num_actions: int, setting: str
) -> SteeringNetwork:
    """Read what `save_controller` wrote, in ``eval()`` mode.

    Raises:
        SettingsError: if the folder that ``setting`` named has none, or one for other
            embeddings or actions.
    """
    path = folder / CONTROLLER_FILE
    make = partial(make_controller, embedding_size, num_actions)
    with torch.device("meta"):
        sizes = make().sizes
    rule = f"{setting} must name a practice with networks and actions as the run's, "
    rule += f"{sizes}"
    with reading_checkpoint(path, setting, _HEADER, "a controller") as state:
        given = read_counts(state["sizes"], sizes)
        require(given == sizes, rule, given)
        return load_weights(make, state["weights"])
