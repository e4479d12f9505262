"""Reads the run folders of a sweep: which settings differ, and what came out.

- `find_runs`: the runs in a folder, with the settings of their command lines.
- `group_runs`: together what differs in the seed alone.
- `read_columns`, `read_pretraining`, `read_exploration`: what a finished run wrote.
"""

import csv
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf

from toponav.config import SettingsError

#: Columns of a table by name.
Columns = dict[str, NDArray[np.float64]]

# They tell no group of runs from another.
_NOT_SETTINGS = ("seed", "resume")
_EPISODE_COLUMNS = ("coverage", "decisions_to_90")


class BrokenRunError(ValueError):
    """A run folder lacks what a finished run leaves there."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run folder and the settings that it was started with.

    Args:
        folder: where it is.
        recipe: the name of its recipe.
        seed: its seed.
        given: what its command line said, without seed and ``resume``.
        config: all its settings.
    """

    folder: Path
    recipe: str
    seed: int
    given: Mapping[str, str]
    config: DictConfig

    def setting(self, name: str) -> str:
        """The value of a setting, whether or not the command line gave it."""
        if name in self.given:
            return self.given[name]
        value = OmegaConf.select(self.config, name)
        if OmegaConf.is_list(value):
            return f"[{','.join(str(one) for one in value)}]"
        return "default" if OmegaConf.is_config(value) else str(value)


@dataclass(frozen=True)
class Exploration:
    """What a run of ``recipes/explore.py`` came to.

    Args:
        evaluation: by policy, the columns of ``evaluation.csv``.
        episodes: the columns of ``episodes.csv``, in the order of the training.
    """

    evaluation: dict[str, Columns]
    episodes: Columns


def find_runs(folder: Path) -> list[Run]:
    """All runs in a folder, at any depth, sorted by their settings and seeds.

    Args:
        folder: of a sweep, or of one run.

    Raises:
        SettingsError: if it is no folder or there is no run in it.
    """
    if not folder.is_dir():
        raise SettingsError(
            f"folder must name the folder of a sweep or a run, got '{folder}'"
        )
    found = [
        _read_run(path.parent.parent)
        for path in folder.rglob("config/overrides.yaml")
        if path.with_name("hydra.yaml").is_file()
    ]
    if not found:
        raise SettingsError(
            f"folder must hold runs of a recipe, got none in '{folder}'"
        )
    return sorted(found, key=lambda run: (sort_key(run.given.values()), run.seed))


def _read_run(folder: Path) -> Run:
    words = OmegaConf.to_object(OmegaConf.load(folder / "config/overrides.yaml"))
    given = {}
    for word in words if isinstance(words, list) else []:
        name, _, value = str(word).lstrip("+~").partition("=")
        if name not in _NOT_SETTINGS:
            given[name] = value
    hydra = OmegaConf.load(folder / "config/hydra.yaml")
    config = OmegaConf.load(folder / "config/config.yaml")
    assert isinstance(config, DictConfig)
    return Run(
        folder,
        recipe=str(OmegaConf.select(hydra, "hydra.job.config_name")),
        seed=int(config.get("seed", 0)),
        given=given,
        config=config,
    )


def swept_settings(runs: Sequence[Run]) -> list[str]:
    """Names of the settings in which runs differ, the seed left out."""
    names = dict.fromkeys(name for run in runs for name in run.given)
    return [name for name in names if len({run.setting(name) for run in runs}) > 1]


def group_runs(
    runs: Iterable[Run], names: Sequence[str]
) -> list[tuple[dict[str, str], list[Run]]]:
    """Put runs together that agree in some settings.

    Args:
        runs: of one recipe.
        names: the settings.

    Returns:
        The settings and the runs of each group; numbers in the order of their size.
    """
    groups: dict[tuple[str, ...], list[Run]] = {}
    for run in runs:
        groups.setdefault(tuple(run.setting(name) for name in names), []).append(run)
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


def read_columns(path: Path) -> dict[str, NDArray[Any]]:
    """A CSV table by columns: float64, NaN for an empty cell, text where it is text.

    Raises:
        BrokenRunError: if there is no such file, it is empty, or a row is too short or
            too long.
    """
    if not path.is_file():
        raise BrokenRunError(f"has no {path.name}")
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    if not rows:
        raise BrokenRunError(f"has an empty {path.name}")
    head, *rows = rows
    if any(len(row) != len(head) for row in rows):
        raise BrokenRunError(f"has broken rows in its {path.name}")
    return {
        name: _column([row[number] for row in rows]) for number, name in enumerate(head)
    }


def _column(cells: list[str]) -> NDArray[Any]:
    try:
        return np.array([float(cell) if cell else math.nan for cell in cells])
    except ValueError:
        return np.array(cells)


def read_pretraining(folder: Path) -> dict[str, dict[str, float]]:
    """By maze, the figures of a finished pre-training.

    Args:
        folder: of the run.

    Returns:
        The numbers of ``report.json``, and these: ``locomotion_accuracy``, over all
        offsets; ``tc_accuracy_k4_m5``, of the last row of ``metrics.csv``, if it is a
        run in one maze; ``waypoint_share_<threshold>``.

    Raises:
        BrokenRunError: if it has not finished.
    """
    try:
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BrokenRunError("has no report.json") from None
    except json.JSONDecodeError:
        raise BrokenRunError("has a broken report.json") from None
    if "mazes" not in report:
        raise BrokenRunError("has a broken report.json")
    history = read_columns(folder / "metrics.csv")
    shares = report.get("waypoint_share", {})
    found = {}
    for maze, figures in report["mazes"].items():
        numbers = {
            name: math.nan if value is None else float(value)
            for name, value in figures.items()
        }
        numbers["locomotion_accuracy"] = _over_offsets(numbers)
        numbers |= {f"waypoint_share_{at}": share for at, share in shares.items()}
        if len(report["mazes"]) == 1 and "tc_accuracy_k4_m5" in history:
            numbers["tc_accuracy_k4_m5"] = float(history["tc_accuracy_k4_m5"][-1])
        found[maze] = numbers
    return found


def _over_offsets(figures: Mapping[str, float]) -> float:
    """Accuracy of the L-network over all pairs, from that at each offset."""
    counts = {
        name.removeprefix("count_"): value
        for name, value in figures.items()
        if re.fullmatch(r"count_\d+", name)
    }
    right = sum(count * figures[f"accuracy_{at}"] for at, count in counts.items())
    return right / sum(counts.values()) if counts else math.nan


def read_exploration(folder: Path) -> Exploration:
    """What a finished exploration wrote.

    Args:
        folder: of the run.

    Raises:
        BrokenRunError: if it has not finished, or a column or the policy ``best`` is
            missing.
    """
    table = read_columns(folder / "evaluation.csv")
    episodes = read_columns(folder / "episodes.csv")
    for name, columns, wanted in (
        ("evaluation.csv", table, ("policy", "seed", *_EPISODE_COLUMNS)),
        ("episodes.csv", episodes, ("decisions", "coverage")),
    ):
        if missing := [column for column in wanted if column not in columns]:
            raise BrokenRunError(f"has no column '{missing[0]}' in its {name}")
    evaluation = {
        str(policy): {
            name: column[table["policy"] == policy]
            for name, column in table.items()
            if name != "policy"
        }
        for policy in dict.fromkeys(table["policy"])
    }
    if "best" not in evaluation:
        raise BrokenRunError("has no evaluation of its best policy")
    if not np.isfinite(table["coverage"]).all():
        raise BrokenRunError("has evaluation episodes without coverage")
    return Exploration(evaluation, episodes)
