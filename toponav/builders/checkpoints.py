"""Files that are whole or not there: written atomically, read without code."""

import os
import pickle
from pathlib import Path

import torch

from toponav.config import SettingsError


def save_atomically(state: dict[str, object], path: Path) -> None:
    """Write a file of tensors and plain values, or leave the old one as it is.

    The name changes hands in one step, after the bytes have reached the disk: a
    process killed at any moment leaves the previous file or the new one.

    Args:
        state: tensors, numbers, strings, lists and dictionaries of these.
        path: the file; its folder must exist.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "state.pt"
        >>> save_atomically({"updates": 3}, path)
        >>> load_checkpoint(path, "resume")
        {'updates': 3}
    """
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with fresh.open("wb") as file:
            torch.save(state, file)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def load_checkpoint(
    path: Path, setting: str, *, device: torch.device | str = "cpu"
) -> dict[str, object]:
    """Read a file that `save_atomically` wrote; no code in it is run.

    Args:
        path: the file.
        setting: the setting that named it, for the error.
        device: where the tensors go.

    Raises:
        SettingsError: if the file is missing, or is none of ours, or is damaged.
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
