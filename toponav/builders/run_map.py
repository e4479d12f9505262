"""The map in an exploration's run folder, and the truth about it."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from toponav.builders.networks import Networks
from toponav.config import SettingsError
from toponav.graph import TopologicalMap
from toponav.graph.map_file import MapFileError, load_map

#: The files in a run folder that hold the map, and where its waypoints truly are.
MAP_FILE, POSES_FILE = "map.zip", "map_poses.npy"


def load_run_map(
    folder: Path, networks: Networks, *, unwalked_cost: float
) -> tuple[TopologicalMap, Tensor]:
    """Read the map of a run, to plan on.

    Args:
        folder: of the run.
        networks: of the same run.
        unwalked_cost: of an edge that was never walked; one that was costs 1.

    Returns:
        The map, and float32 ``[W, 3]``, where its waypoints truly are, x and y in map
        units and heading in degrees.

    Raises:
        SettingsError: if there is no map, it is damaged, or the truth does not fit it.
    """
    path, truth = folder / MAP_FILE, folder / POSES_FILE
    for file in (path, truth):
        if not file.is_file():
            raise SettingsError(
                f"run must name an exploration with a map, got '{folder}' without "
                f"{file.name}"
            )
    tc = networks.tc
    grown = TopologicalMap(
        tc.embed,
        tc.compare_prepared,
        prepare=tc.prepare_memory,
        tc_threshold=0.5,
        tc_reach=0.5,
        unwalked_cost=unwalked_cost,
    )
    try:
        state, _ = load_map(path)
        grown.load_state_dict(state)
        poses = torch.from_numpy(np.load(truth, allow_pickle=False)).float()
    except (MapFileError, ValueError, OSError, EOFError) as error:
        raise SettingsError(f"run: {error}") from error
    if poses.shape != (grown.num_waypoints, 3):
        raise SettingsError(
            f"run must name an exploration whose {POSES_FILE} has a row of three for "
            f"each of {grown.num_waypoints} waypoints, got {tuple(poses.shape)}"
        )
    return grown, poses
