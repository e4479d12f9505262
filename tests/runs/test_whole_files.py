"""Files of a run are whole or absent, whenever its process is killed."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image

from tests.graph.grey_world import episode, make_map
from toponav.graph import ViewFile, load_map, save_map
from toponav.plotting import save_figure, write_video
from toponav.plotting.style import new_figure
from toponav.runs import (
    remove_halves,
    save_atomically,
    write_array,
    write_history,
    write_text,
)

ROOT = Path(__file__).parents[2]


def write_endlessly(folder: Path, name: str) -> None:
    """What a run writes under such a name, again and again."""
    torch.set_num_threads(1)
    path, turn = folder / name, 0
    grown, views = make_map(), ViewFile(folder / "map_views.bin")
    grown.add_episode(episode(*range(0, 250, 12), views=True))
    while True:
        turn += 1
        if name == "checkpoint.pt":
            views.append(torch.full((30, 40, 3), turn % 256, dtype=torch.uint8))
            save_atomically(views.state_dict() | {"turn": turn}, path)
        elif name == "metrics.csv":
            write_history(path, [{"turn": turn, "row": row} for row in range(2000)])
        elif name == "map_poses.npy":
            write_array(path, np.full((300, 300), turn))
        elif name == "report.json":
            write_text(path, json.dumps({"a": 200_000 * "x"}))
        elif name == "map.zip":
            save_map(grown.state_dict(), path)
        elif name == "map.png":
            save_figure(new_figure(3, 2, title=str(turn)), path)
        else:
            noise = np.random.default_rng(turn).integers(0, 255, (20, 64, 64, 3))
            write_video(path, noise.astype(np.uint8), fps=10)


def read_checkpoint(path: Path) -> None:
    """The views that it refers to are those of its moment."""
    state = torch.load(path, weights_only=True)
    views = ViewFile(path.with_name("map_views.bin"))
    views.load_state_dict(state)
    assert len(views) == state["turn"]
    assert (views.read(len(views) - 1, len(views)) == state["turn"] % 256).all()


#: Files as a run calls them, and what fails on half of one.
READERS = {
    "checkpoint.pt": read_checkpoint,
    "metrics.csv": lambda path: pd.read_csv(path).loc[1999],
    "map_poses.npy": np.load,
    "report.json": lambda path: json.loads(path.read_text()),
    "map.zip": load_map,
    "map.png": lambda path: Image.open(path).load(),
    "episode.mp4": lambda path: iio.imread(path)[19],
}


def kill_writers(folder: Path, turns: int) -> None:
    """Kill a writer of each file at several moments; raises if a file is cut."""
    found = 0
    for name, read in READERS.items():
        for turn in range(turns):
            if not (writer := os.fork()):
                write_endlessly(folder, name)
            time.sleep(0.05 + 0.037 * turn)
            deadline = time.monotonic() + 30
            while not ((folder / name).exists() or time.monotonic() > deadline):
                time.sleep(0.01)
            os.kill(writer, signal.SIGKILL)
            os.waitpid(writer, 0)
            if (folder / name).exists():
                read(folder / name)
            found += len([*folder.glob(".*")])
            remove_halves(folder)
            left = {path.name for path in folder.iterdir()}
            assert left <= {*READERS, "map_views.bin"}, left
    assert {path.name for path in folder.iterdir()} == {*READERS, "map_views.bin"}
    assert found, "no kill hit a write"


@pytest.mark.slow
def test_a_kill_leaves_whole_files_and_the_next_start_no_others(tmp_path: Path) -> None:
    # A process of its own, whose children have nobody else's threads.
    given = [sys.executable, "-m", __name__, str(tmp_path)]
    done = subprocess.run(given, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr


def test_only_what_was_being_written_is_removed(tmp_path: Path) -> None:
    keep = (".lock", "map.png", "logs/csv/loss.csv", "config/config.yaml")
    gone = (
        ".map.12.png",
        ".checkpoint.7.pt",
        "logs/csv/.loss.3.csv",
        "config/.draws.3.yaml",
    )
    for name in (*keep, *gone):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    # A run does not look into folders that are not its own.
    (tmp_path / "other").mkdir()
    (tmp_path / "other/.map.12.png").touch()
    remove_halves(tmp_path)
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")}
    assert left == {
        *keep,
        "logs",
        "logs/csv",
        "config",
        "other",
        "other/.map.12.png",
    }


#: How a file can be written, and where that is done: in `replacing` or by its like, in
#: the file of views, which checkpoints refer to, and where no run keeps anything.
_WRITES = re.compile(
    r"""\.write_(text|bytes)\(|\.savefig\(|torch\.save\(|np\.savez?\w*\(|\.imwrite\(
    |imopen\(.*"w"|\.to_(csv|json|parquet|pickle)\((?!index)|\.(dump)\(
    |open\([^)]*"[rwa]\+?b?\+?"|ZipFile\([^)]*"[wa]" """,
    re.VERBOSE,
)
_KNOWN = {
    "toponav/runs/files.py",
    "toponav/runs/checkpoint_files.py",
    "toponav/graph/map_file.py",
    "toponav/graph/views.py",
    "toponav/plotting/style.py",
    "toponav/plotting/video.py",
    "toponav/builders/pretraining.py",  # its lock
    "toponav/runs/locks.py",  # locks
    "toponav/experiments/making.py",  # what a run prints, as it comes
    "toponav/envs/engines/doom/instances.py",  # an engine's own folder
    "toponav/envs/engines/dmlab/engine.py",  # the log in an engine's own folder
    "toponav/envs/engines/dmlab/child.py",  # a lock of the cache of compiled maps
}


def test_nothing_is_written_past_them() -> None:
    sources = [*ROOT.glob("toponav/**/*.py"), *ROOT.glob("recipes/*.py")]
    lines = {
        str(path.relative_to(ROOT)): [
            line
            for line in path.read_text(encoding="utf-8").splitlines()
            if _WRITES.search(line) and not re.search(r'open\([^)]*"rb?"', line)
        ]
        for path in sources
    }
    assert {name for name, found in lines.items() if found} <= _KNOWN
    assert lines["toponav/runs/files.py"]


if __name__ == "__main__":
    kill_writers(Path(sys.argv[1]), turns=8)
