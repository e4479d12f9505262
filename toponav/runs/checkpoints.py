"""Checkpoints: tensors and plain values, read without running code."""

import pickle
from pathlib import Path

import torch

from toponav.config import SettingsError
from toponav.runs.atomic import replacing

#: The file in a run folder from which a run is resumed.
CHECKPOINT_FILE = "checkpoint.pt"


def save_atomically(state: dict[str, object], path: Path) -> None:
    """Write tensors and plain values as one file that is never half written."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        torch.save(state, file)


def load_checkpoint(
    path: Path, setting: str, *, device: torch.device | str = "cpu"
) -> dict[str, object]:
    """Read a file that `save_atomically` wrote; ``setting`` named it, for the error.

    Raises:
        SettingsError: if the file is missing or damaged, or is not a checkpoint.
    """
    if not path.is_file():
        raise SettingsError(f"{setting} must name a run with {path.name}, got {path}")
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except (OSError, RuntimeError, EOFError, ValueError, pickle.UnpicklingError) as bad:
        reason = str(bad).strip().splitlines()[0] if str(bad).strip() else "empty"
        raise SettingsError(
            f"{setting} must name a file that was written whole, got the damaged "
            f"{path} ({reason[:80]})"
        ) from bad
    if not isinstance(state, dict):
        raise SettingsError(
            f"{setting} must name a file of this package, got {path} with a "
            f"{type(state).__name__}"
        )
    return state
