"""How long the runs of an experiment take, said before the first one starts."""

import math
from collections import Counter
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


def every_cell(cells: Sequence[Cell]) -> list[Cell]:
    """Each cell once, first runs before their followers."""
    found: dict[str, Cell] = {}
    for cell in cells:
        for one in (*cell.before, cell):
            found.setdefault(one.key, one)
    return list(found.values())


def missing_cells(cells: Sequence[Cell]) -> list[Cell]:
    """Cells to be made, each once, first runs before their followers.

    They have no results or, of runs that come first, not the networks or the map from
    which a missing one starts.
    """
    found: dict[str, Cell] = {}
    for cell in cells:
        if cell.results is None:
            for one in cell.before:
                if not is_finished(one.folder):
                    found.setdefault(one.key, one)
            found.setdefault(cell.key, cell)
    return list(found.values())


def kind_of(cell: Cell) -> str:
    """What runs that take about as long have in common, as messages call it."""
    if cell.recipe == "explore":
        return f"explorations with loss={cell.config.loss.name}"
    return {"pretrain": "pre-trainings", "navigate": "navigations"}[cell.recipe]


def expected_seconds(
    settings: ReproduceConfig, cells: Sequence[Cell]
) -> tuple[dict[str, float], int, bool]:
    """Seconds of each missing cell, by key, and where they are from.

    The median of the finished runs of the same recipe and row, or else learner; without
    any the figure of ``conf/reproduce``, NaN if it has none.

    Returns:
        The seconds, how many runs were measured, and whether some of the seconds are
        figures of ``conf/reproduce``.
    """
    measured: dict[tuple[str, str], list[float]] = {}
    count, by_figure = 0, False
    for cell in every_cell(cells):
        at = cell.results
        if at is not None and not math.isnan(s := seconds_of(at)):
            count += 1
            for name in (cell.row, kind_of(cell)):
                measured.setdefault((cell.recipe, name), []).append(s)
    found = {}
    for cell in missing_cells(cells):
        names = [(cell.recipe, name) for name in (cell.row, kind_of(cell))]
        own = measured.get(names[0]) or measured.get(names[1])
        if own is not None:
            found[cell.key] = median(own)
            continue
        learner = OmegaConf.select(cell.config, "loss.name")
        found[cell.key] = settings.seconds_of(cell.recipe, learner)
        by_figure |= not math.isnan(found[cell.key])
    return found, count, by_figure


def to_make(
    settings: ReproduceConfig, cells: Sequence[Cell]
) -> tuple[list[Cell], dict[str, float]]:
    """The missing cells, and how many seconds each should take, by key."""
    expected, _, _ = expected_seconds(settings, cells)
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
    """One line: what is missing and how long it will take, and how that is known.

    Runs of which nobody knows it are named, and not in the time.
    """
    missing = missing_cells(cells)
    total = len({cell.key for cell in cells} | {cell.key for cell in missing})
    name = settings.experiment.name
    if not cells:
        return f"{name}: no row has its settings chosen yet"
    if not missing:
        return f"{name}: all {total} runs are there"
    expected, count, by_figure = expected_seconds(settings, cells)
    first = missing_pretrainings(missing)
    text = f"{name}: {len(missing)} of {total} runs are missing"
    if first:
        text += f", and {len(first)} pre-trainings"
    each = settings.seconds_of("pretrain")
    times = [(kind_of(cell), expected[cell.key]) for cell in missing]
    times += [("pre-trainings", each)] * len(first)
    known = [seconds for _, seconds in times if not math.isnan(seconds)]
    unknown = Counter(kind for kind, seconds in times if math.isnan(seconds))
    if known:
        of = f" for {len(known)} of them" if unknown else ""
        side = "one at a time"
        if settings.jobs > 1:
            side = f"{settings.jobs} side by side"
        by_figure |= bool(first) and not math.isnan(each)
        text += f"; about {hours(sum(known) / settings.jobs)}{of}, {side} "
        text += f"(an estimate from {_source(count, by_figure)})"
    if unknown:
        kinds = ", ".join(f"{kind} ({number})" for kind, number in unknown.items())
        text += f"; not measured: {kinds}"
    return text


def _source(count: int, by_figure: bool) -> str:
    """Where an estimate is from."""
    parts = [f"{count} runs of this experiment"] if count else []
    if by_figure:
        parts.append("figures in conf/reproduce")
    return " and ".join(parts)
