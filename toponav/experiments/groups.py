"""What a table is made of: the finished runs of each row in each maze."""

import math
from collections.abc import Mapping, Sequence
from glob import escape
from pathlib import Path
from typing import Any

from toponav.builders import make_layout
from toponav.config import ReproduceConfig, maze_words, paper_figures
from toponav.experiments.cells import KEPT, Cell, mazes_of, rows_of
from toponav.experiments.decisions_before import decisions_before, explore_settings
from toponav.experiments.kept_runs import copy_missing
from toponav.methods import make_world
from toponav.reports import Group, baselines_file, scripted_rows


def make_groups(settings: ReproduceConfig, cells: Sequence[Cell]) -> list[Group]:
    """The groups of an experiment, in the order of its rows and mazes."""
    paper = paper_figures(settings.experiment.paper)
    groups = []
    for row in rows_of(settings):
        for given in mazes_of(settings, row):
            maze, _ = maze_words(given)
            own = [cell for cell in cells if (cell.row, cell.maze) == (row.label, maze)]
            found = {one.seed: one.results for one in own}
            runs = {seed: at for seed, at in found.items() if at is not None}
            known = (decisions_before(one) for one in own if one.results is not None)
            before = next(filter(math.isfinite, known), math.nan)
            figures = paper.get((row.label, maze), {})
            group = Group(
                *(row.label, maze, runs, len(own), before, row.against, figures),
                cells=_num_maze_cells(own[0]),
            )
            groups.append(group)
    return groups


def _num_maze_cells(cell: Cell) -> int | None:
    """Cells of the maze that a cell explores, closed ones left out."""
    if cell.recipe != "explore" or cell.config.world.name != "maze":
        return None
    maze = explore_settings(cell).maze
    return make_layout(maze).num_cells - len(set(maze.blocked))


def scripted_of(
    settings: ReproduceConfig, cells: Sequence[Cell], *, play: bool
) -> Mapping[str, list[dict[str, Any]]]:
    """By maze, the episodes of the experiment's scripted policies.

    They are kept beside the table and, where other runs look for them, put back.
    """
    names, found = settings.experiment.scripted, dict[str, list[dict[str, Any]]]()
    kept = Path(settings.folder) / KEPT / "baselines"
    for cell in cells:
        if names and cell.recipe == "explore" and cell.maze not in found:
            config = explore_settings(cell)
            world = make_world(config)
            file = baselines_file(config, world)
            every = f"{escape(file.stem)}*.json"
            copy_missing(kept, file.parent, every)
            found[cell.maze] = scripted_rows(config, world, names, play=play)
            copy_missing(file.parent, kept, every)
    return found


def missing_sentences(cells: Sequence[Cell], failures: Mapping[str, str]) -> list[str]:
    """A sentence for every run that a table lacks."""
    sentences = []
    for cell in cells:
        if cell.results is None:
            why = failures.get(cell.key, "it is not made yet")
            sentences.append(f"missing: {cell.name}: {why}")
    return sentences
