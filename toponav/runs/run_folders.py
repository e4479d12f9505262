"""Reads the run folders of a sweep: which settings differ, and what came out."""

import csv
import json
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import DictConfig, ListConfig, OmegaConf

from toponav.config import read_yaml, require
from toponav.runs.draws import DRAWS_FILE

# Settings in which the runs of one group may differ: chance, and places of others.
_NOT_SETTINGS = ("seed", "resume", "pretraining.folder", "evaluate.random_folder")


class BrokenRunError(ValueError):
    """A run folder lacks what a finished run leaves there."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run folder and the settings that it was started with.

    ``given`` holds those of its command line, without seed, ``resume`` and ``drawn``:
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
    """All runs in a folder, at any depth, sorted by their settings and seeds.

    Raises:
        SettingsError: if it is no folder or there is no run in it.
    """
    rule = "folder must name the folder of a sweep or a run"
    require(folder.is_dir(), rule, f"'{folder}'")
    found = [
        _read_run(path.parent.parent)
        for path in folder.rglob("config/overrides.yaml")
        if path.with_name("hydra.yaml").is_file()
    ]
    require(bool(found), "folder must hold runs of a recipe", f"none in '{folder}'")
    return sorted(found, key=lambda run: (sort_key(run.given.values()), run.seed))


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
        BrokenRunError: if the file, a column or a cell is missing, or it is empty.
    """
    if not path.is_file():
        raise BrokenRunError(f"has no {path.name}")
    # pandas fills rows that are too short.
    with path.open(newline="", encoding="utf-8") as file:
        widths = {len(row) for row in csv.reader(file)}
    if not widths:
        raise BrokenRunError(f"has an empty {path.name}")
    if len(widths) > 1:
        raise BrokenRunError(f"has broken rows in its {path.name}")
    table = pd.read_csv(path)
    _require_columns(table, columns, path.name)
    return table


def _require_columns(table: pd.DataFrame, columns: Iterable[str], file: str) -> None:
    for column in columns:
        if column not in table:
            raise BrokenRunError(f"has no column '{column}' in its {file}")


def read_pretraining(folder: Path) -> pd.DataFrame:
    """The numbers of ``report.json``, a row a maze, and some that follow from them.

    These are ``locomotion_accuracy`` over all offsets, ``waypoint_share_<threshold>``
    and, of a run in one maze, the last ``tc_accuracy_k4_m5`` of ``metrics.csv``.

    Raises:
        BrokenRunError: if it has not finished.
    """
    try:
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        found = pd.DataFrame.from_dict(report["mazes"], orient="index", dtype=float)
    except FileNotFoundError:
        raise BrokenRunError("has no report.json") from None
    except (json.JSONDecodeError, KeyError):
        raise BrokenRunError("has a broken report.json") from None
    # Accuracy over all pairs, from that at each offset.
    counts = found.filter(regex=r"^count_\d+$")
    right = found[counts.columns.str.replace("count", "accuracy")].to_numpy() * counts
    found["locomotion_accuracy"] = right.sum(axis=1) / counts.sum(axis=1)
    for at, share in report.get("waypoint_share", {}).items():
        found[f"waypoint_share_{at}"] = share
    history = read_table(folder / "metrics.csv")
    if len(found) == 1 and "tc_accuracy_k4_m5" in history:
        found["tc_accuracy_k4_m5"] = history["tc_accuracy_k4_m5"].iloc[-1]
    return found


def read_navigation(folder: Path) -> pd.DataFrame:
    """The episodes of a finished navigation, a row for each of each policy.

    Raises:
        BrokenRunError: if it has not finished, or a column is missing.
    """
    columns = ("policy", "episode", "goals", "reward", "first_goal")
    return read_table(folder / "episodes.csv", columns)


def read_exploration(folder: Path) -> Exploration:
    """The tables of a finished exploration.

    Raises:
        BrokenRunError: if it has not finished, a column is missing, or neither of its
            policies ``best`` and ``last`` was evaluated.
    """
    evaluation = read_table(folder / "evaluation.csv", ("policy", "seed"))
    measure, percent, columns = "intrinsic_return", 1, ["intrinsic_return"]
    if "coverage" in evaluation:
        measure, percent, columns = "coverage", 100, ["decisions_to_90"]
    _require_columns(evaluation, columns, "evaluation.csv")
    episodes = read_table(folder / "episodes.csv", ("decisions", measure))
    # Without a best policy where rewards of different times do not compare.
    if not evaluation["policy"].isin(["best", "last"]).any():
        raise BrokenRunError("has no evaluation of its best or last policy")
    if not np.isfinite(evaluation[measure]).all():
        raise BrokenRunError(f"has evaluation episodes without {measure}")
    evaluation["score"] = percent * evaluation[measure]
    episodes["score"] = percent * episodes[measure]
    return Exploration(evaluation, episodes, measure)
