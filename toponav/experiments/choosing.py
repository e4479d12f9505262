"""Settings drawn by chance: tried in mazes that a table lacks, the best one kept."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from omegaconf import OmegaConf

from toponav.config import ReproduceConfig, RowConfig
from toponav.experiments.cells import Cell, plan_cells, rows_of
from toponav.experiments.found_runs import is_finished
from toponav.reports import judged_score


@dataclass(frozen=True)
class Choice:
    """The draw of a row that covered most, in the mean over the mazes of the tries."""

    row: str
    words: tuple[str, ...]  # the settings that were drawn
    coverage: float  # in %
    tries: int  # draws that were made in all mazes


def plan_tries(settings: ReproduceConfig) -> list[Cell]:
    """The runs that try ``tries`` draws of each row in the mazes of ``choose_on``.

    A draw is a seed. Rows without drawn settings, and rows that take the choice of
    another one, have none.
    """
    experiment = settings.experiment
    rows = [
        replace(
            row,
            overrides=[*row.overrides, *drawn],
            mazes=experiment.choose_on,
            against=None,
        )
        for row in _choosing_rows(settings)
        if (drawn := experiment.drawn_of(row))
    ]
    if not rows or not settings.tries:
        return []
    return plan_cells(
        replace(
            settings,
            experiment=replace(experiment, rows=rows),
            rows=[],
            seeds=settings.tries,
            most_mazes=None,
        )
    )


def _choosing_rows(settings: ReproduceConfig) -> list[RowConfig]:
    """Rows that are wanted and choose for themselves, and those that others follow."""
    experiment, wanted = settings.experiment, rows_of(settings)
    labels = {row.choice_of or row.label for row in wanted}
    return [row for row in experiment.rows if row.label in labels]


def choose(settings: ReproduceConfig, tries: Sequence[Cell]) -> list[Choice]:
    """The best draw of each row; none of a row without one that is made in all mazes.

    The last policy of a run is judged, as in the table.
    """
    found = []
    for row in _choosing_rows(settings):
        mine = [cell for cell in tries if cell.row == row.label]
        scores: dict[int, list[float]] = {}
        for cell in mine:
            scores.setdefault(cell.seed, [])
            if is_finished(cell.folder):
                scores[cell.seed].append(judged_score(cell.folder))
        mazes = len({cell.maze for cell in mine})
        means = {
            seed: sum(one) / mazes for seed, one in scores.items() if len(one) == mazes
        }
        if means:
            best = max(means, key=means.__getitem__)
            config = next(cell.config for cell in mine if cell.seed == best)
            names = [
                word.partition("=")[0] for word in settings.experiment.drawn_of(row)
            ]
            words = tuple(f"{name}={OmegaConf.select(config, name)}" for name in names)
            found.append(Choice(row.label, words, means[best], len(means)))
    return found


def with_choices(
    settings: ReproduceConfig, choices: Sequence[Choice]
) -> ReproduceConfig:
    """The experiment with the chosen settings in its rows, and in their first runs.

    Rows whose choice is missing are left out.
    """
    experiment, by_row = settings.experiment, {one.row: one for one in choices}
    rows = []
    for row in rows_of(settings):
        choice = by_row.get(row.choice_of or row.label)
        if choice is not None:
            first = [*row.first, *choice.words] if row.first else []
            own = [*row.overrides, *choice.words]
            row = replace(row, overrides=own, first=first, choice_of=None)
        elif experiment.drawn_of(row) or row.choice_of:
            continue
        rows.append(row)
    labels = {row.label for row in rows}
    rows = [
        row if row.against in labels else replace(row, against=None) for row in rows
    ]
    return replace(settings, experiment=replace(experiment, rows=rows), rows=[])


def choice_sentences(settings: ReproduceConfig, choices: Sequence[Choice]) -> list[str]:
    """What a reader of the table is told of the choices, and which are missing."""
    mazes = ", ".join(one.partition(":")[0] for one in settings.experiment.choose_on)
    sentences = [
        f"{one.row}: {' '.join(one.words)}, the best of {one.tries} random draws in "
        f"{mazes} ({one.coverage:.1f} % covered)"
        for one in choices
    ]
    chosen = {one.row for one in choices}
    return sentences + [
        f"missing: {row.label}: its settings are not chosen yet"
        for row in _choosing_rows(settings)
        if row.label not in chosen and settings.experiment.drawn_of(row)
    ]
