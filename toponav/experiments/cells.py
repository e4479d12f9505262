"""`Cell`: a run of an experiment, from its row, maze and seed to its settings."""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from hydra import compose
from omegaconf import DictConfig, OmegaConf

from toponav.config import (
    ReproduceConfig,
    RowConfig,
    SettingsError,
    maze_words,
)
from toponav.experiments.found_runs import (
    OTHER_RUNS,
    find_keys,
    named_run,
    plain,
    run_key,
)
from toponav.refusals import sentence_of

# In the settings of a row: the folder of the run that comes first.
_FIRST = "{first}"


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
    #: The run whose networks or policy it starts from.
    first: "Cell | None" = None

    @property
    def name(self) -> str:
        """How messages call it."""
        parts = (self.row, self.maze, f"seed {self.seed}")
        return ", ".join(part for part in parts if part)


def rows_of(settings: ReproduceConfig) -> list[RowConfig]:
    """The rows that were asked for, and those that they are compared with."""
    rows = settings.experiment.rows
    wanted = set(settings.rows or [row.label for row in rows])
    wanted |= {row.against for row in rows if row.label in wanted and row.against}
    return [row for row in rows if row.label in wanted]


def mazes_of(settings: ReproduceConfig, row: RowConfig) -> list[str]:
    """The mazes of a row, with the settings that choose them."""
    return list(row.mazes or settings.experiment.mazes)[: settings.most_mazes]


def plan_cells(settings: ReproduceConfig) -> list[Cell]:
    """All cells of an experiment, in the order of its rows, mazes and seeds.

    Runs are looked for in ``runs``; those that are not there get a folder whose name
    has their key.

    Raises:
        SettingsError: if a row has settings that its recipe refuses.
    """
    found = find_keys(Path(settings.runs))
    cells: list[Cell] = []
    for row in rows_of(settings):
        for given in mazes_of(settings, row):
            maze, words = maze_words(given)
            cells += _cells_of(settings, row, maze, words, found)
    return cells


def _cells_of(
    settings: ReproduceConfig,
    row: RowConfig,
    maze: str,
    words: list[str],
    found: Mapping[str, Path],
) -> Iterator[Cell]:
    """The cells of a row in a maze, one a seed."""
    recipe, base = settings.experiment.recipe, _base_words(settings)
    own = [*base, *words, *map(_quote, settings.overrides_of(row))]
    config = _compose(recipe, own, row.label)
    earlier = _compose(recipe, [*base, *row.first], row.label) if row.first else None
    for seed in range(settings.seeds):
        first = None
        if earlier is not None:
            name, given = f"{row.label} (first run)", [*base, *row.first]
            first = _make_cell(settings, name, "", seed, given, earlier, found)
        yield _make_cell(settings, row.label, maze, seed, own, config, found, first)


def _base_words(settings: ReproduceConfig) -> list[str]:
    """Settings of all runs of the experiment."""
    experiment, runs = settings.experiment, settings.runs
    words = [f"scale={settings.scale}", *settings.overrides_of(experiment)]
    if experiment.recipe == "explore":
        words.append(f"pretraining.folder='{runs}/pretrain'")
        words.append(f"evaluate.random_folder='{runs}/baselines'")
        return [*words, *settings.explore_overrides]
    return [*words, *settings.pretrain_overrides]


def _make_cell(
    settings: ReproduceConfig,
    row: str,
    maze: str,
    seed: int,
    words: list[str],
    config: DictConfig,
    found: Mapping[str, Path],
    first: Cell | None = None,
) -> Cell:
    """A cell of a composed configuration, with a seed."""
    recipe, config = settings.experiment.recipe, copy.deepcopy(config)
    config.seed = seed
    others = [name for name in OTHER_RUNS if config.get(name) == _FIRST]
    if first is not None:
        # The key must not depend on whether the first run is there yet.
        for name in others:
            config[name] = named_run(first.key)
    key = run_key(recipe, plain(config))
    if first is not None:
        for name in others:
            config[name] = str(first.folder)
        words = [word.replace(_FIRST, str(first.folder)) for word in words]
    folder = found.get(key)
    if folder is None:
        label = OmegaConf.select(config, "world.label")
        folder = Path(settings.runs) / recipe / f"{label}-{settings.scale}-{key}"
    given = (*words, f"seed={seed}")
    return Cell(row, maze, seed, recipe, given, config, key, folder, first)


def _quote(word: str) -> str:
    return word.replace(_FIRST, f"'{_FIRST}'")


def _compose(recipe: str, words: list[str], row: str) -> DictConfig:
    """The settings of a recipe's command line, checked like its own."""
    try:
        config = compose(recipe, overrides=words)
        OmegaConf.to_object(config)
    except Exception as error:
        if (sentence := sentence_of(error, recipe)) is None:
            raise
        rule = f"row '{row}' must have settings of {recipe}"
        raise SettingsError(f"{rule}: {sentence}") from error
    return config
