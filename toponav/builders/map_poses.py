"""The file that says where the waypoints of a map truly are, which no agent reads."""

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from toponav.builders.beside_map import MAP_FILE, POSES_FILE, find_beside
from toponav.config import SettingsError, require
from toponav.runs import reason_of


def load_poses(
    folder: Path, about: Mapping[str, str], *, num_waypoints: int, setting: str
) -> Tensor:
    """Read the poses of W waypoints: x and y in map units, and degrees.

    Args:
        folder: of a run, which ``setting`` named.
        about: the words about its map.
        num_waypoints: W.
        setting: named in errors.

    Returns:
        float32 ``[W, 3]``.

    Raises:
        SettingsError: if there is no file of that map, or it is damaged.
    """
    path = find_beside(folder, POSES_FILE, about)
    rule = f"{setting} must name an exploration whose {POSES_FILE}"
    given = f"that of another map in '{folder}'"
    require(path is not None, f"{rule} belongs to its {MAP_FILE}", given)
    assert path is not None
    rule += f" has a row of three for each of {num_waypoints} waypoints"
    try:
        # What numpy warns of, it has not written so.
        with warnings.catch_warnings(action="error"):
            # A header may promise more than memory holds: nothing is read yet.
            found = np.lib.format.open_memmap(path, mode="r")
        if found.dtype.kind not in "fiu" or not found.dtype.isnative:
            raise ValueError("it holds other than finite numbers")
        require(found.shape == (num_waypoints, 3), rule, found.shape)
        with np.errstate(over="ignore"):
            poses = np.array(found, np.float32, order="C")
        if not np.isfinite(poses).all():
            raise ValueError("it holds other than finite numbers")
    except SettingsError:
        raise
    except Exception as bad:  # damage can make numpy fail in any way
        rule = f"{setting} must name a complete file, got the damaged {path}"
        raise SettingsError(f"{rule} ({reason_of(bad)})") from bad
    return torch.from_numpy(poses)
