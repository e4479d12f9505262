"""Files of a run folder that cannot be read, or should be gone, for `faults`."""

import csv
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import torch
import yaml
from PIL import Image

from toponav.graph import load_map


def _read_pt(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
    torch.load(path, weights_only=True)


def _read_csv(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.endswith("\n")
    assert len({len(row) for row in csv.reader(text.splitlines())}) == 1


def _read_picture(path: Path) -> None:
    with Image.open(path) as picture:
        picture.load()


READERS: dict[str, Callable[[Path], object]] = {
    ".pt": _read_pt,
    ".zip": load_map,
    ".npy": np.load,
    ".csv": _read_csv,
    ".png": _read_picture,
    ".yaml": lambda path: yaml.safe_load(path.read_text()),
    ".json": lambda path: json.loads(path.read_text()),
    ".mp4": lambda path: iio.imread(path)[0],
    ".log": Path.read_text,
    ".lock": Path.read_bytes,
    # What of it counts is in the checkpoint, whose reader compares checksums.
    ".bin": Path.read_bytes,
}


def temporary_files(folder: Path) -> list[str]:
    """Hidden files, which become others once they are whole; locks are none."""
    found = [path for path in folder.rglob(".*") if path.name != ".lock"]
    return sorted(str(path.relative_to(folder)) for path in found)


def broken_files(folder: Path, *, cut: bool = False) -> list[str]:
    """Files that their reader refuses, or that have none.

    With ``cut``, those that grow line by line may end anywhere: the resume deals with
    them.
    """
    found, temporary = [], temporary_files(folder)
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_dir() or name in temporary or "tfevents" in path.name:
            continue
        if cut and name.startswith("logs/"):
            continue
        try:
            READERS[path.suffix or path.name](path)
        except Exception as error:  # whatever a reader says
            found.append(f"{name}: {type(error).__name__} {error}"[:200])
    return found
