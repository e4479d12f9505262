"""A map as it grew, and made again of few waypoints by the poses of its views.

    python benchmarks/pose_maps.py runs/explore/select-... --within 4 2 \
        --out results/pose_maps.csv --copies runs/explore/pose-maps

The map of an exploration is taken from its checkpoint, where it is as it grew, and made
again (``map.poses``) for each distance up to which a waypoint stands for a view. The
ground truth judges all of them, and the poses of the waypoints that stay. ``--copies``
keeps each map in a run folder of its own, ``<folder>-grown`` and ``<folder>-4``, for
``recipes/navigate.py run=...``.
"""

import argparse
import csv
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from toponav.builders import load_networks
from toponav.config import ExploreConfig
from toponav.methods import make_world, register
from toponav.runs import CHECKPOINT_FILE
from toponav.training import MapGrowth

CONF = Path(__file__).resolve().parent.parent / "conf"
QUALITY = (
    *("waypoints", "edges", "coverage", "false_edges", "false_paths", "missing_edges"),
    *("components", "true_components", "stretch", "last_waypoint_share"),
)
COLUMNS = ["maze", "seed", "map", "waypoints_per_cell", *QUALITY, "seconds"]


def read_settings(run: Path) -> ExploreConfig:
    """Those that the run was made with."""
    register()
    given = OmegaConf.load(run / "config" / "overrides.yaml")
    # As they were given: some refer to other settings.
    words = OmegaConf.to_container(given, resolve=False)
    assert isinstance(words, list)
    with initialize_config_dir(str(CONF), version_base="1.3"):
        settings = OmegaConf.to_object(compose("explore", overrides=words))
    assert isinstance(settings, ExploreConfig)
    return settings


def restore(run: Path, copy: Path, within: float | None) -> tuple[MapGrowth, int]:
    """The map's growth as the checkpoint has it, in ``copy``, and the maze's cells."""
    networks = load_networks(run)
    settings = read_settings(run).resolved(networks.model)
    changed = replace(settings.map, poses=True)
    if within is not None:
        changed = replace(changed, poses_within=within)
    world = make_world(settings)
    growth = MapGrowth(replace(settings, map=changed), world, networks, copy)
    saved = torch.load(run / CHECKPOINT_FILE, weights_only=True)
    growth.load_state_dict(saved["consumers"]["map"])
    assert world.layout is not None
    return growth, len(world.layout.cells)


def measure(run: Path, copy: Path, within: float | None) -> dict[str, Any]:
    """Make one of the maps, keep it in ``copy``, and judge it."""
    growth, cells = restore(run, copy, within)
    start = time.process_time()
    views = None if within is None else growth.consolidate()
    if views is not None:
        growth.learn_places(*views)
    seconds = time.process_time() - start
    growth.write(copy)
    growth.writer.wait()
    row = growth.rows[-1]
    found = {name: row[name] for name in QUALITY}
    settings = read_settings(run)
    about = {"maze": settings.maze.name, "seed": settings.seed}
    about["map"] = "as it grew" if within is None else f"within {within:g}"
    per_cell = row["waypoints"] / cells
    return {**about, "waypoints_per_cell": per_cell, **found, "seconds": seconds}


def main() -> None:
    """Make the maps, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--within", nargs="+", type=float, default=[4.0])
    parser.add_argument("--copies", type=str)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for run in options.runs:
        for within in [None, *options.within]:
            name = "grown" if within is None else f"{within:g}"
            with tempfile.TemporaryDirectory() as folder:
                copy = Path(folder) / "run"
                if options.copies:
                    copy = Path(f"{options.copies}-{run.name}-{name}")
                left_out = shutil.ignore_patterns(CHECKPOINT_FILE, "logs")
                shutil.copytree(run, copy, ignore=left_out)
                row = measure(run, copy, within)
            rows.append([rounded(row[name]) for name in COLUMNS])
            print(dict(zip(COLUMNS, rows[-1], strict=True)), flush=True)
    if options.out:
        with options.out.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


def rounded(value: object) -> object:
    """What a table has of a value: four digits of a float."""
    return round(value, 4) if isinstance(value, float) else value


if __name__ == "__main__":
    main()
