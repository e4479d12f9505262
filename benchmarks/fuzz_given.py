"""What recipes of `fuzz` are given to start from: finished runs, made or played."""

import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

from fuzz_cases import ROOT

from tests.explored import RING, make_run, navigate_settings
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
    """A folder with the runs, made in a second; nobody writes into it."""
    folder = _make_folder()
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


@cache
def played() -> Path:
    """A folder with runs that recipes made in a ring, in some minutes.

    These are ``pretrained``, ``explored`` and ``navigated``, and the blind baselines.
    """
    folder = _make_folder()
    (folder / "ring.txt").write_text(RING)
    pretrained = f"pretrained={folder / 'pretrained'}"
    for recipe, name, words in (
        ("pretrain", "pretrained", ring_words(folder)),
        ("explore", "explored", [*ring_words(folder), "reward=rnd", pretrained]),
        ("navigate", "navigated", [f"run={folder / 'explored'}"]),
    ):
        words = ["scale=smoke", *words, f"hydra.run.dir={folder / name}"]
        command = [sys.executable, str(ROOT / "recipes" / f"{recipe}.py"), *words]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder


def ring_words(folder: Path) -> list[str]:
    """The maze in which they were played."""
    return ["maze=file", f"maze.path={folder / 'ring.txt'}"]


def _make_folder() -> Path:
    _FOLDERS.append(tempfile.TemporaryDirectory(prefix="toponav-fuzz-given-"))
    return Path(_FOLDERS[-1].name)
