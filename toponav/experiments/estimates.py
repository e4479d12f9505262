"""How long the runs of an experiment take, said before the first one starts."""

import math
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from omegaconf import OmegaConf

from toponav.builders import NETWORKS_FILE, pretraining_folder
from toponav.config import ReproduceConfig
from toponav.experiments.cells import Cell
from toponav.experiments.found_runs import is_finished, seconds_of
from toponav.experiments.making import hours
from toponav.methods import REWARDS


def missing_cells(cells: Sequence[Cell]) -> list[Cell]:
    """Cells that are not finished, each once, first runs before their followers."""
    wanted: dict[str, Cell] = {}
    for cell in cells:
        for one in (*cell.before, cell):
            if one.key not in wanted:
                wanted[one.key] = one
    return [cell for cell in wanted.values() if not is_finished(cell.folder)]


def expected_seconds(
    settings: ReproduceConfig, cells: Sequence[Cell]
) -> tuple[dict[str, float], int]:
    """Seconds of each missing cell, by key, and of how many runs they were measured.

    The median of the finished runs of the same row, or else of all of the experiment;
    without any the figure of ``conf/reproduce``, NaN if it has none.
    """
    measured: dict[str, list[float]] = {}
    for cell in {cell.key: cell for cell in cells}.values():
        if is_finished(cell.folder) and not math.isnan(s := seconds_of(cell.folder)):
            measured.setdefault(cell.row, []).append(s)
    every = [one for times in measured.values() for one in times]
    found = {}
    for cell in missing_cells(cells):
        usual = settings.seconds_of(cell.recipe)
        if every and cell.recipe == settings.experiment.recipe:
            usual = median(every)
        own = measured.get(cell.row)
        found[cell.key] = usual if own is None else median(own)
    return found, len(every)


def to_make(
    settings: ReproduceConfig, cells: Sequence[Cell]
) -> tuple[list[Cell], dict[str, float]]:
    """The missing cells, and how many seconds each should take, by key."""
    expected, _ = expected_seconds(settings, cells)
    return missing_cells(cells), expected


def missing_pretrainings(cells: Sequence[Cell]) -> set[Path]:
    """Folders of the pre-trainings that these explorations begin with."""
    folders = set()
    for cell in cells:
        if cell.recipe != "explore" or cell.config.pretrained is not None:
            continue
        if REWARDS[cell.config.reward.name].needs_networks:
            folder = pretraining_folder(OmegaConf.to_object(cell.config))  # type: ignore[arg-type]
            if not (folder / NETWORKS_FILE).is_file():
                folders.add(folder)
    return folders


def announce(settings: ReproduceConfig, cells: Sequence[Cell]) -> str:
    """One line: what is missing and how long it will take, and how that is known."""
    missing = missing_cells(cells)
    total = len({cell.key for cell in cells} | {cell.key for cell in missing})
    name = settings.experiment.name
    if not missing:
        return f"{name}: all {total} runs are there"
    expected, count = expected_seconds(settings, cells)
    first = missing_pretrainings(missing)
    text = f"{name}: {len(missing)} of {total} runs are missing"
    if first:
        text += f", and {len(first)} pre-trainings"
    each = settings.pretrain_s
    more = len(first) * (math.nan if each is None else each) if first else 0.0
    seconds = (sum(expected.values()) + more) / settings.jobs
    if math.isnan(seconds):
        return f"{text}; how long they take is not known, no such run was made here"
    source = (
        f"{count} runs of this experiment" if count else "figures in conf/reproduce"
    )
    side = "one at a time" if settings.jobs == 1 else f"{settings.jobs} side by side"
    return f"{text}; about {hours(seconds)}, {side} (an estimate from {source})"
