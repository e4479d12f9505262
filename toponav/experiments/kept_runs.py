"""Small copies of finished runs beside a table, which outlive the runs' folders."""

import re
import shutil
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omegaconf import ListConfig, OmegaConf

from toponav.config import read_yaml
from toponav.experiments.cells import Cell
from toponav.experiments.decisions_before import keep_decisions_before
from toponav.experiments.found_runs import is_finished
from toponav.runs import locked, replacing, write_text

# What tables, figures and estimates are made of: no networks, maps or pictures. Without
# ``hydra.yaml``, which names places of this machine, nobody takes a copy for a run.
_KEPT = (
    *("config/config.yaml", "config/overrides.yaml"),
    *("evaluation.csv", "episodes.csv", "metrics.csv", "phases.csv"),
    *("summary.csv", "report.json"),
)


def keep_run(cell: Cell) -> None:
    """Copy the tables of a finished run to where it is kept, all of them or none.

    What is kept already stays as it is: a table made again is the same. What its
    networks learned from is added where an earlier version did not keep it.
    """
    kept = cell.kept
    if kept is None:
        return
    is_kept = cell.results == kept
    if is_kept:
        keep_decisions_before(cell, kept)
    is_new = not is_kept and is_finished(cell.folder)
    if not is_new and not _halves(kept):
        return
    kept.parent.mkdir(parents=True, exist_ok=True)
    # Another process may make the same table; what lies there unlocked, nobody writes.
    with locked(kept.with_name(f".{kept.name}.lock")):
        for half in _halves(kept):
            shutil.rmtree(half, ignore_errors=True)
        if is_new and cell.results != kept:
            _copy(cell, kept)


def _halves(kept: Path) -> list[Path]:
    """What killed processes, or one that is at it, left of a copy."""
    name = re.compile(rf"\.{re.escape(kept.name)}\.\w{{8}}")  # as `tempfile` adds to it
    return [path for path in kept.parent.glob(".*") if name.fullmatch(path.name)]


def _copy(cell: Cell, kept: Path) -> None:
    with TemporaryDirectory(prefix=f".{kept.name}.", dir=kept.parent) as place:
        whole = Path(place) / kept.name
        for name in _KEPT:
            copy_missing(cell.folder, whole, name)
        _forget_resume(whole / "config")
        keep_decisions_before(cell, whole)
        # A damaged one, which no run is read from.
        shutil.rmtree(kept, ignore_errors=True)
        whole.rename(kept)


def _forget_resume(saved: Path) -> None:
    """Settings as of a run that was never cut off; where it lay is nobody's matter."""
    path = saved / "config.yaml"
    config = read_yaml(path)
    if OmegaConf.select(config, "resume") is None:
        return
    config.resume = None
    write_text(path, OmegaConf.to_yaml(config))
    path = saved / "overrides.yaml"
    if path.is_file():
        # As they were given: what one names, such as ${seed}, is no other word.
        words: Any = OmegaConf.to_container(read_yaml(path, ListConfig))
        others = [word for word in words if not str(word).startswith("resume=")]
        write_text(path, OmegaConf.to_yaml(OmegaConf.create(others)))


def keep_runs(cells: Iterable[Cell]) -> None:
    """Keep those of the runs that are finished."""
    for cell in cells:
        keep_run(cell)


def copy_missing(source: Path, target: Path, pattern: str) -> None:
    """Copy the files of a pattern that another folder lacks, none of them in part."""
    for file in source.glob(pattern):
        copy = target / file.relative_to(source)
        if not copy.is_file():
            copy.parent.mkdir(parents=True, exist_ok=True)
            with replacing(copy) as temporary:
                shutil.copyfile(file, temporary)
