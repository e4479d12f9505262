"""Settings drawn by chance: tried in mazes that a table lacks, the best one kept."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from omegaconf import OmegaConf

from toponav.config import ReproduceConfig, RowConfig
from toponav.experiments.cells import MAZE, Cell, plan_cells, rows_of
from toponav.reports import judged_score, kept_return


@dataclass(frozen=True)
class Choice:
    """The best draw of a row, in the mean over the mazes of the tries."""

    row: str
    words: tuple[str, ...]  # the settings that were drawn
    score: float
    measure: str  # of the score, as a sentence has it
    tries: int  # draws that were made in all mazes


def plan_tries(settings: ReproduceConfig) -> list[Cell]:
    """The runs that try ``tries`` draws of each row in the mazes of ``choose_on``.

    A draw is a seed. Rows without drawn settings, and rows that take the choice of
    another one, have none. All are explorations: in an experiment that navigates, those
    that train a row's policy or, without any, explore for its map.
    """
    experiment = settings.experiment
    rows = [
        _tried_row(settings, row)
        for row in _choosing_rows(settings)
        if experiment.drawn_of(row)
    ]
    if not rows or not settings.tries:
        return []
    tried = replace(experiment, rows=rows)
    if experiment.recipe == "navigate":
        tried = replace(tried, recipe="explore", overrides=[])
        tried = replace(tried, laptop_overrides=[], paper_overrides=[])
        # They are in the rows: a rival's policy has none.
        settings = replace(settings, explore_overrides=[])
    return plan_cells(
        replace(
            settings,
            experiment=tried,
            rows=[row.label for row in rows],
            seeds=settings.tries,
            first_seed=0,
            most_mazes=None,
        )
    )


def _tried_row(settings: ReproduceConfig, row: RowConfig) -> RowConfig:
    """The explorations that try the draws of a row."""
    experiment = settings.experiment
    tried = replace(row, mazes=experiment.choose_on, against=None)
    more = [*experiment.choose_with, *experiment.drawn_of(row)]
    if experiment.recipe == "explore":
        return replace(tried, overrides=[*row.overrides, *more])
    own = settings.policy_of(row) or [*settings.explore_overrides, *row.first]
    words = [word for word in own if word != MAZE]
    return RowConfig(label=row.label, overrides=[*words, *more], mazes=tried.mazes)


def _choosing_rows(settings: ReproduceConfig) -> list[RowConfig]:
    """Rows that are wanted and choose for themselves, and those that others follow."""
    labels = set[str | None]()
    for row in rows_of(settings):
        labels |= {row.choice_of or row.label, _mapper(settings, row)}
    return [row for row in settings.experiment.rows if row.label in labels]


def _chooser(settings: ReproduceConfig, row: RowConfig) -> str | None:
    """The row whose choice is for a row's own settings, if any are drawn."""
    return row.choice_of or (row.label if settings.experiment.drawn_of(row) else None)


def _mapper(settings: ReproduceConfig, row: RowConfig) -> str | None:
    """The row whose choice is for the map that a rival plays over: its explorer's."""
    for one in settings.experiment.rows if row.policy else ():
        if not one.policy and one.first == row.first:
            return _chooser(settings, one)
    return None


def choose(settings: ReproduceConfig, tries: Sequence[Cell]) -> list[Choice]:
    """The best draw of each row; none of a row without one that is made in all mazes.

    The last policy of a run is judged by its coverage, as in the table; that of a rival
    that navigates by the reward that it gets, with the policy that the run kept.
    """
    found = []
    for row in _choosing_rows(settings):
        judge = kept_return if row.policy else judged_score
        mine = [cell for cell in tries if cell.row == row.label]
        scores: dict[int, list[float]] = {}
        for cell in mine:
            scores.setdefault(cell.seed, [])
            if (results := cell.results) is not None:
                scores[cell.seed].append(judge(results))
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
            measure = "reward of an episode" if row.policy else "% covered"
            choice = Choice(row.label, words, means[best], measure, len(means))
            found.append(choice)
    return found


def with_choices(
    settings: ReproduceConfig, choices: Sequence[Choice]
) -> ReproduceConfig:
    """The experiment with the chosen settings in its rows, and in their first runs.

    Rows whose choice is missing are left out.
    """
    experiment, by_row = settings.experiment, {one.row: one for one in choices}
    made = [_chosen_row(settings, row, by_row) for row in rows_of(settings)]
    rows = [row for row in made if row is not None]
    labels = {row.label for row in rows}
    rows = [
        row if row.against in labels else replace(row, against=None) for row in rows
    ]
    named = [row.label for row in rows]
    return replace(settings, experiment=replace(experiment, rows=rows), rows=named)


def _chosen_row(
    settings: ReproduceConfig, row: RowConfig, by_row: Mapping[str, Choice]
) -> RowConfig | None:
    """A row with its chosen settings; ``None`` if some are not chosen yet."""
    chooser, mapper = _chooser(settings, row), _mapper(settings, row)
    if any(one is not None and one not in by_row for one in (chooser, mapper)):
        return None
    own = by_row[chooser].words if chooser else ()
    mapped = by_row[mapper].words if mapper else ()
    if row.policy:
        # After those of the scale, which may set the same.
        policy, first = [*settings.policy_of(row), *own], [*row.first, *mapped]
        row = replace(row, laptop_policy=[], paper_policy=[])
        return replace(row, policy=policy, first=first, choice_of=None)
    first = [*row.first, *own] if row.first else []
    if settings.experiment.recipe == "explore":
        row = replace(row, overrides=[*row.overrides, *own])
    return replace(row, first=first, choice_of=None)


def choice_sentences(settings: ReproduceConfig, choices: Sequence[Choice]) -> list[str]:
    """What a reader of the table is told of the choices, and which are missing."""
    mazes = ", ".join(one.partition(":")[0] for one in settings.experiment.choose_on)
    sentences = [
        f"{one.row}: {' '.join(one.words)}, the best of {one.tries} random draws in "
        f"{mazes} ({one.score:.1f} {one.measure})"
        for one in choices
    ]
    chosen = {one.row for one in choices}
    return sentences + [
        f"missing: {row.label}: its settings are not chosen yet"
        for row in _choosing_rows(settings)
        if row.label not in chosen and settings.experiment.drawn_of(row)
    ]


def undrawn_sentences(settings: ReproduceConfig) -> list[str]:
    """What a reader is told of a table whose rows could have drawn, and did not.

    At the paper's scale every seed is a draw.
    """
    drawn = any(map(settings.experiment.drawn_of, _choosing_rows(settings)))
    if settings.tries or settings.scale == "paper" or not drawn:
        return []
    return ["tries=0: no row draws settings by chance; each has those that it names."]
