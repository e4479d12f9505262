"""What recipes of `fuzz` are given to start from: finished runs, made in a second."""

import tempfile
from functools import cache
from pathlib import Path

from tests.explored import make_run, navigate_settings
from tests.sweeps import make_exploration, make_pretraining
from toponav.builders import (
    PLACES_FILE,
    load_exploration,
    make_controller,
    save_controller,
    save_trials,
)
from toponav.graph import EdgeTrials

#: The runs in `given`: an exploration of a ring, and the same with a map without poses.
EXPLORED, BARE = "explored", "bare"
#: A practice on the former's map, and a sweep to report on, with runs of two recipes.
PRACTISED, SWEEP = "practised", "sweep"
_FOLDERS = list[tempfile.TemporaryDirectory[str]]()  # until this process ends


@cache
def given() -> Path:
    """A folder with the runs, the same one each time; nobody writes into it."""
    _FOLDERS.append(tempfile.TemporaryDirectory(prefix="toponav-fuzz-given-"))
    folder = Path(_FOLDERS[-1].name)
    for name in (EXPLORED, BARE):
        make_run(folder / name, "map.poses=true", poses=True)
    (folder / BARE / PLACES_FILE).unlink()
    known, _ = load_exploration(navigate_settings(folder / EXPLORED))
    practised = folder / PRACTISED
    practised.mkdir()
    sizes = known.map.embeddings.shape[1], known.world.num_actions
    save_controller(make_controller(*sizes), practised)
    save_trials(EdgeTrials(known.map.edges), practised)
    for seed in (0, 1):
        make_exploration(folder / SWEEP, "maze=maze3", seed=seed, best=[0.9, 0.8])
    make_pretraining(folder / SWEEP, "k=2", mazes={"select": 0.9})
    return folder
