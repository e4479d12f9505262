"""The file of `EdgeTrials`, in the folder of a practice."""

from pathlib import Path

import torch
from torch import Tensor

from toponav.config import require
from toponav.graph import EdgeTrials
from toponav.runs import (
    reading_checkpoint,
    require_like,
    require_plain,
    save_atomically,
)

#: The file in a run folder that holds them.
TRIALS_FILE = "edge_trials.pt"
_HEADER = {"kind": "toponav edge trials", "version": 1}


def save_trials(trials: EdgeTrials, folder: Path) -> None:
    """Write ``edge_trials.pt``, atomically."""
    save_atomically({**_HEADER, **trials.state_dict()}, folder / TRIALS_FILE)


def load_trials(folder: Path, edges: Tensor, *, setting: str) -> EdgeTrials:
    """Read what `save_trials` wrote of a map's ``edges`` ``[E, 2]``.

    Raises:
        SettingsError: if the folder that ``setting`` named has none, or those of
            another map.
    """
    trials = EdgeTrials(edges)
    path, own = folder / TRIALS_FILE, trials.state_dict()
    with reading_checkpoint(path, setting, _HEADER, "edge trials") as state:
        found = {name: state[name] for name in own}
        require_plain(found)
        rule = f"{setting} must name a practice on the run's map of {len(edges)} edges"
        given = f"one of another map, of {len(found['edges'])}"
        require(torch.equal(found["edges"], trials.edges), rule, given)
        require_like(found, own)
        trials.load_state_dict(found)
    return trials
