"""`Cell`: a run of an experiment, from its row, maze and seed to its settings."""

import copy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from hydra import compose
from omegaconf import DictConfig, OmegaConf

from toponav.config import (
    ReproduceConfig,
    RowConfig,
    SettingsError,
    maze_words,
    require,
)
from toponav.experiments.found_runs import (
    OTHER_RUNS,
    find_keys,
    find_mapped,
    is_finished,
    named_run,
    plain,
    run_key,
)
from toponav.refusals import sentence_of

#: The folder beside a table that keeps what it is made of.
KEPT = "runs"
# In the settings of a row: the folders of runs that come first, and in those of these
# the setting that names the maze.
_FIRST, _POLICY, MAZE = "{first}", "{policy}", "{maze}"


@dataclass(frozen=True, eq=False)
class Cell:
    """A run that an experiment needs; equal settings are one cell."""

    row: str
    maze: str
    seed: int
    recipe: str
    words: tuple[str, ...]  # its command line
    config: DictConfig
    key: str
    folder: Path  # where it is, or will be
    #: The run whose networks, map or policy it starts from.
    first: "Cell | None" = None
    #: The run whose policy navigates.
    policy: "Cell | None" = None
    #: Where its tables are kept once it is finished, or will be.
    kept: Path | None = None

    @property
    def before(self) -> "tuple[Cell, ...]":
        """The runs that must be there first."""
        return tuple(one for one in (self.first, self.policy) if one is not None)

    @property
    def results(self) -> Path | None:
        """The folder of its tables, the kept ones first; ``None`` if not finished."""
        if self.kept is not None and is_finished(self.kept, networks=False):
            return self.kept
        return self.folder if is_finished(self.folder) else None

    @property
    def name(self) -> str:
        """How messages call it."""
        parts = (self.row, self.maze, f"seed {self.seed}")
        return ", ".join(part for part in parts if part)


def rows_of(settings: ReproduceConfig) -> list[RowConfig]:
    """The rows that were asked for, and those that they are compared with.

    Without a word about rows, those whose method has passed its sanity task.
    """
    rows = settings.experiment.rows
    wanted = set(settings.rows or [row.label for row in rows if row.passed])
    wanted |= {row.against for row in rows if row.label in wanted and row.against}
    return [row for row in rows if row.label in wanted]


def untested_sentences(settings: ReproduceConfig) -> list[str]:
    """A sentence for each row that is left out since its method has not passed."""
    shown = {row.label for row in rows_of(settings)}
    return [
        f"'{row.label}' is left out: its method has not passed a sanity task of its "
        f"own paper's kind (rows=['{row.label}'] makes it all the same)"
        for row in settings.experiment.rows
        if not row.passed and row.label not in shown
    ]


def mazes_of(settings: ReproduceConfig, row: RowConfig) -> list[str]:
    """The mazes of a row, with the settings that choose them."""
    return list(row.mazes or settings.experiment.mazes)[: settings.most_mazes]


def plan_cells(settings: ReproduceConfig) -> list[Cell]:
    """All cells of an experiment, in the order of its rows, mazes and seeds.

    Runs are looked for in ``runs``; those that are not there get a folder whose name
    has their key. One with a map is a row's as well as one without.

    Raises:
        SettingsError: if a row has settings that its recipe refuses, or another world
            than a maze.
    """
    runs = Path(settings.runs)
    found, mapped = find_keys(runs), find_mapped(runs)
    cells: list[Cell] = []
    for row in rows_of(settings):
        for given in mazes_of(settings, row):
            maze, words = maze_words(given)
            cells += _cells_of(settings, row, maze, words, found, mapped)
    return cells


def _cells_of(
    settings: ReproduceConfig,
    row: RowConfig,
    maze: str,
    words: list[str],
    found: Mapping[str, Path],
    mapped: Mapping[str, Path],
) -> Iterator[Cell]:
    """The cells of a row in a maze, one a seed."""
    recipe, base = settings.experiment.recipe, _base_words(settings)
    own = [*base, *words, *map(_quote, settings.overrides_of(row))]
    config = _compose(recipe, own, row.label)
    before = "explore" if recipe == "navigate" else recipe
    names = {_FIRST: f"{row.label} (first run)", _POLICY: f"{row.label} (policy)"}
    lines = dict(_words_before(settings, row, words))
    configs = {mark: _compose(before, line, row.label) for mark, line in lines.items()}
    if recipe != "pretrain":
        _require_mazes(row, [config, *configs.values()])
    first = settings.first_seed
    for seed in range(first, first + settings.seeds):
        earlier = {
            mark: _make_cell(
                settings, names[mark], "", before, line, seed, configs[mark], found
            )
            for mark, line in lines.items()
        }
        cell = _make_cell(
            settings, row.label, maze, recipe, own, seed, config, found, earlier
        )
        # Nothing starts from this one, which would know it by its own settings.
        if cell.key in mapped and not is_finished(cell.folder):
            cell = replace(cell, folder=mapped[cell.key])
        yield cell


def _require_mazes(row: RowConfig, configs: Iterable[DictConfig]) -> None:
    """Refuse worlds without the truth that explorations and tours are judged by."""
    for config in configs:
        world = OmegaConf.select(config, "world.name", default="maze")
        rule = f"row '{row.label}' must have world=maze, to be judged by its plan"
        require(world == "maze", rule, f"world={world}")


def _words_before(
    settings: ReproduceConfig, row: RowConfig, words: list[str]
) -> Iterator[tuple[str, list[str]]]:
    """What stands for the folder of a run that comes first, and its command line."""
    base, explore = _base_words(settings), list[str]()
    if settings.experiment.recipe == "navigate":
        base, explore = _explore_words(settings), settings.explore_overrides
    lines = {_POLICY: settings.policy_of(row)}
    if row.first:
        lines[_FIRST] = [*explore, *row.first]
    for mark, given in lines.items():
        if given:
            # What else is chosen of the maze, such as closed slots, is not for these.
            yield mark, [*base, *(word.replace(MAZE, words[0]) for word in given)]


def _base_words(settings: ReproduceConfig) -> list[str]:
    """Settings of all runs of the experiment."""
    experiment = settings.experiment
    own = settings.overrides_of(experiment)
    if experiment.recipe == "navigate":
        given = [*map(_quote, own), *settings.navigate_overrides]
        return [f"navigate={settings.scale}", *given]
    if experiment.recipe == "explore":
        return [*_explore_words(settings, own), *settings.explore_overrides]
    return [f"scale={settings.scale}", *own, *settings.pretrain_overrides]


def _explore_words(settings: ReproduceConfig, own: Sequence[str] = ()) -> list[str]:
    runs = settings.runs
    words = [f"scale={settings.scale}", *own, f"pretraining.folder='{runs}/pretrain'"]
    return [*words, f"evaluate.random_folder='{runs}/baselines'"]


def _make_cell(
    settings: ReproduceConfig,
    row: str,
    maze: str,
    recipe: str,
    words: list[str],
    seed: int,
    config: DictConfig,
    found: Mapping[str, Path],
    before: Mapping[str, Cell] | None = None,
) -> Cell:
    """A cell of a composed configuration, with a seed.

    ``before`` has the runs that come first by what stands for their folders.
    """
    config, before = copy.deepcopy(config), before or {}
    config.seed = seed
    others = {name: OmegaConf.select(config, name) for name in OTHER_RUNS}
    others = {name: mark for name, mark in others.items() if mark in before}
    # The key must not depend on whether the first runs are there yet.
    for name, mark in others.items():
        OmegaConf.update(config, name, named_run(before[mark].key))
    key = run_key(recipe, plain(config))
    for name, mark in others.items():
        OmegaConf.update(config, name, str(before[mark].folder))
    for mark, one in before.items():
        words = [word.replace(mark, str(one.folder)) for word in words]
    folder = found.get(key)
    if folder is None:
        label = OmegaConf.select(config, "world.label") or config.maze.name
        folder = Path(settings.runs) / recipe / f"{label}-{settings.scale}-{key}"
    given, kept = (*words, f"seed={seed}"), Path(settings.folder) / KEPT / key
    first, policy = (before.get(mark) for mark in (_FIRST, _POLICY))
    return Cell(
        *(row, maze, seed, recipe, given, config, key, folder, first, policy, kept)
    )


def _quote(word: str) -> str:
    for mark in (_FIRST, _POLICY):
        word = word.replace(mark, f"'{mark}'")
    return word


def _compose(recipe: str, words: list[str], row: str) -> DictConfig:
    """The settings of a recipe's command line, checked like its own."""
    try:
        return _composed(recipe, tuple(words))
    except Exception as error:
        if (sentence := sentence_of(error, recipe)) is None:
            raise
        rule = f"row '{row}' must have settings of {recipe}"
        raise SettingsError(f"{rule}: {sentence}") from error


# Rows share the runs that come first, and composing takes longer than all else here.
@cache
def _composed(recipe: str, words: tuple[str, ...]) -> DictConfig:
    """Valid settings of a command line; who changes some must copy them."""
    config = compose(recipe, overrides=list(words))
    OmegaConf.to_object(config)
    return config
