"""Reads the run folders of a sweep: which settings differ, and what came out."""

import csv
import json
import math
import os
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import DictConfig, ListConfig, OmegaConf
from pandas.api.types import is_numeric_dtype

from toponav.config import read_yaml, require
from toponav.runs.checkpoint_files import CHECKPOINT_FILE
from toponav.runs.draws import DRAWS_FILE

#: Beside a run's settings, of a maze with a file of its own: what it was.
LAYOUT_FILE = "layout.txt"
# Runs are at most so deep in a folder of sweeps, which has at most so many folders.
_DEEPEST, _MOST_FOLDERS = 4, 10_000
# Beside its settings, what a run needs to be reported on.
_NEEDED = ("overrides", "hydra")
# Columns of tables that hold words.
_WORDS = ("policy", "phase")
# Settings in which the runs of one group may differ: chance, and places of others.
_NOT_SETTINGS = (
    *("seed", "pretraining.seed"),
    *("resume", "pretraining.folder", "evaluate.random_folder"),
)
# What a run leaves that is over, or can be resumed: all files of one of these.
_RESULTS = (
    (CHECKPOINT_FILE,),
    ("networks.pt", "report.json"),
    ("summary.md",),
    ("walk.mp4",),
    ("walk.gif",),
)


class BrokenRunError(ValueError):
    """A run folder lacks what a finished run leaves there."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run folder and the settings that it was started with.

    ``given`` holds those of its command line, without seeds, ``resume`` and ``drawn``:
    settings that `log_uniform` drew, with their numbers.
    """

    folder: Path
    recipe: str
    seed: int
    given: Mapping[str, str]
    config: DictConfig
    drawn: Mapping[str, float]

    def setting(self, name: str) -> str:
        """The value of a setting, whether or not the command line gave it."""
        if name in self.given:
            return self.given[name]
        value = OmegaConf.select(self.config, name)
        if OmegaConf.is_list(value):
            return f"[{','.join(str(one) for one in value)}]"
        return "default" if OmegaConf.is_config(value) else str(value)


@dataclass(frozen=True, eq=False)
class Exploration:
    """The tables ``evaluation.csv`` and ``episodes.csv`` of an exploration.

    Both have a column ``score``: the ``measure``, of ``coverage`` in percent.
    """

    evaluation: pd.DataFrame
    episodes: pd.DataFrame
    measure: str  # without ground truth: intrinsic_return


def find_runs(folder: Path) -> list[Run]:
    """All runs in a folder of sweeps, sorted by their settings and seeds.

    Raises:
        SettingsError: if it is no folder, there is no run in it, or `folders_of_runs`
            refuses it.
    """
    rule = "folder must name the folder of a sweep or a run"
    require(folder.is_dir(), rule, f"'{folder}'")
    found = [
        _read_run(one)
        for one in folders_of_runs(folder, "folder")
        if all((one / f"config/{name}.yaml").is_file() for name in _NEEDED)
    ]
    require(bool(found), "folder must hold runs of a recipe", f"none in '{folder}'")
    return sorted(found, key=lambda run: (sort_key(run.given.values()), run.seed))


def has_results(folder: Path) -> bool:
    """Whether a run in this folder is over, or can be resumed."""
    return any(all((folder / one).is_file() for one in files) for files in _RESULTS)


def folders_of_runs(folder: Path, setting: str) -> Iterator[Path]:
    """The folders with settings of a run, at most four folders deep in another one.

    Those of runs, hidden folders and links are not looked into.

    Args:
        folder: to look in; none is the same as an empty one.
        setting: that names it.

    Raises:
        SettingsError: if it holds so many folders that it is none of sweeps.
    """
    for number, (at, names, _) in enumerate(os.walk(folder)):
        rule = f"{setting} must name the folder of a sweep or a run"
        given = f"'{folder}', which has more than {_MOST_FOLDERS:,} folders"
        require(number < _MOST_FOLDERS, rule, given)
        is_run = Path(at, "config/config.yaml").is_file()
        if is_run:
            yield Path(at)
        if is_run or len(Path(at).relative_to(folder).parts) == _DEEPEST:
            names.clear()
        names[:] = [name for name in names if not name.startswith(".")]


def _read_run(folder: Path) -> Run:
    saved = folder / "config"
    # Words with an interpolation are kept as they are.
    overrides = read_yaml(saved / "overrides.yaml", ListConfig)
    words: Any = OmegaConf.to_container(overrides)
    file = saved / DRAWS_FILE
    drawn = read_yaml(file) if file.is_file() else {}
    pairs = [str(word).lstrip("+~").partition("=") for word in words]
    hidden = {*_NOT_SETTINGS, *drawn}
    hydra, config = (read_yaml(saved / f"{name}.yaml") for name in ("hydra", "config"))
    return Run(
        folder,
        recipe=str(OmegaConf.select(hydra, "hydra.job.config_name")),
        seed=int(config.get("seed", 0)),
        given={name: value for name, _, value in pairs if name not in hidden},
        config=config,
        drawn=drawn,
    )


def swept_settings(runs: Sequence[Run]) -> list[str]:
    """Names of the settings in which runs differ, the seed left out."""
    names = dict.fromkeys(name for run in runs for name in run.given)
    return [name for name in names if len({run.setting(name) for run in runs}) > 1]


def group_runs(
    runs: Iterable[Run], names: Sequence[str]
) -> list[tuple[dict[str, str], list[Run]]]:
    """The settings of these names and the runs that agree in them, sorted."""
    groups = defaultdict(list)
    for run in runs:
        groups[tuple(run.setting(name) for name in names)].append(run)
    return [
        (dict(zip(names, values, strict=True)), groups[values])
        for values in sorted(groups, key=sort_key)
    ]


def sort_key(values: Iterable[str]) -> list[tuple[float, str]]:
    """Orders texts with numbers by their size, and before other texts.

    Examples:
        >>> sorted([["10"], ["maze1"], ["9"]], key=sort_key)
        [['9'], ['10'], ['maze1']]
    """
    number = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)
    return [
        (float(text), "") if number.fullmatch(text) else (math.inf, text)
        for text in values
    ]


def read_table(path: Path, columns: Iterable[str] = ()) -> pd.DataFrame:
    """A CSV table that must have these columns; NaN for an empty cell.

    Raises:
        BrokenRunError: if it is missing, empty or no table, lacks a column or a cell,
            or one of these columns that is none of words holds other than numbers.
    """
    if not path.is_file():
        raise BrokenRunError(f"has no {path.name}")
    try:
        table = _parse_table(path)
    except BrokenRunError:
        raise
    except (csv.Error, ValueError):  # no UTF-8, or a cell that has no end
        raise BrokenRunError(f"has a broken {path.name}") from None
    _require_columns(table, columns, path.name)
    return table


def _parse_table(path: Path) -> pd.DataFrame:
    # pandas fills rows that are too short.
    with path.open(newline="", encoding="utf-8") as file:
        widths = {len(row) for row in csv.reader(file)}
    if not widths:
        raise BrokenRunError(f"has an empty {path.name}")
    if len(widths) > 1:
        raise BrokenRunError(f"has broken rows in its {path.name}")
    return pd.read_csv(path)


def _require_columns(table: pd.DataFrame, columns: Iterable[str], file: str) -> None:
    for column in columns:
        if column not in table:
            raise BrokenRunError(f"has no column '{column}' in its {file}")
        if column not in _WORDS and not is_numeric_dtype(table[column]):
            raise BrokenRunError(f"has other than numbers as '{column}' in its {file}")


def read_pretraining(folder: Path) -> pd.DataFrame:
    """The numbers of ``report.json``, a row a maze, and some that follow from them.

    These are ``locomotion_accuracy`` over all offsets, ``waypoint_share_<threshold>``
    and, of a run in one maze, the last ``tc_accuracy_k4_m5`` of ``metrics.csv``.

    Raises:
        BrokenRunError: if it has not finished, or one of the files is damaged.
    """
    try:
        content = (folder / "report.json").read_bytes()
    except FileNotFoundError:
        raise BrokenRunError("has no report.json") from None
    try:
        found = _parse_report(content)
    except Exception:  # damage can make any of its readers fail in any way
        raise BrokenRunError("has a broken report.json") from None
    history = read_table(folder / "metrics.csv")
    if len(found) == 1 and "tc_accuracy_k4_m5" in history:
        _require_columns(history, ["tc_accuracy_k4_m5"], "metrics.csv")
        found["tc_accuracy_k4_m5"] = history["tc_accuracy_k4_m5"].iloc[-1]
    return found


def _parse_report(content: bytes) -> pd.DataFrame:
    report = json.loads(content.decode("utf-8"))
    found = pd.DataFrame.from_dict(report["mazes"], orient="index", dtype=float)
    # Accuracy over all pairs, from that at each offset.
    counts = found.filter(regex=r"^count_\d+$")
    right = found[counts.columns.str.replace("count", "accuracy")].to_numpy() * counts
    found["locomotion_accuracy"] = right.sum(axis=1) / counts.sum(axis=1)
    for at, share in report.get("waypoint_share", {}).items():
        found[f"waypoint_share_{at}"] = share
    if "accuracy" not in found:
        raise ValueError("no accuracy of the TC-network")
    return found.astype(float)


def read_exploration(folder: Path) -> Exploration:
    """The tables of a finished exploration.

    Raises:
        BrokenRunError: if it has not finished, a column is missing, or neither of its
            policies ``best`` and ``last`` was evaluated.
    """
    evaluation = read_table(folder / "evaluation.csv", ("policy", "seed"))
    measure, percent, columns = "intrinsic_return", 1, ["intrinsic_return"]
    if "coverage" in evaluation:
        measure, percent, columns = "coverage", 100, ["coverage", "decisions_to_90"]
    _require_columns(evaluation, columns, "evaluation.csv")
    # Of many environments, short runs finish no whole episode.
    if not (folder / "episodes.csv").is_file():
        raise BrokenRunError("has no episodes.csv: no episode of its training ended")
    episodes = read_table(folder / "episodes.csv", ("decisions", measure))
    # Without a best policy where rewards of different times do not compare.
    if not evaluation["policy"].isin(["best", "last"]).any():
        raise BrokenRunError("has no evaluation of its best or last policy")
    if not np.isfinite(evaluation[measure]).all():
        raise BrokenRunError(f"has evaluation episodes without {measure}")
    evaluation["score"] = percent * evaluation[measure]
    episodes["score"] = percent * episodes[measure]
    return Exploration(evaluation, episodes, measure)


def read_navigation(folder: Path) -> pd.DataFrame:
    """The episodes of a finished navigation, a row for each of each policy.

    Raises:
        BrokenRunError: if it has not finished, a column is missing, or an episode does
            not say how many goals were reached in it.
    """
    columns = ("policy", "goals", "reward", "first_goal", "spl")
    episodes = read_table(folder / "episodes.csv", columns)
    if not np.isfinite(episodes["goals"]).all():
        raise BrokenRunError("has episodes without goals")
    return episodes
