"""Runs are found again by their settings: what a run is, and which are there."""

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from toponav.builders import NETWORKS_FILE
from toponav.config import SettingsError, read_yaml
from toponav.runs import (
    BrokenRunError,
    folders_of_runs,
    read_exploration,
    read_navigation,
    read_pretraining,
    read_table,
)

#: Settings that change how a run is made, or where, and not what comes out.
_NOT_RESULTS = frozenset(
    (
        *("resume", "threads", "device", "collect.max_idle_s", "pretraining.folder"),
        *("collect.backend", "collect.device", "ray.address"),
        *("report.every", "report.pictures_every_s", "report.save_every_s"),
        *("evaluate.random_folder", "train.threads", "train.save_every_s"),
    )
)
#: Numbers that were in code before they were settings; with them a run keeps its key.
_FORMER = {"locomotion.weight_decay": 1e-3}
#: Settings that hold words for another recipe, of which the same is left out.
_WORDS = "pretraining.overrides"
#: Settings that name the run of others.
OTHER_RUNS = ("pretrained", "init_from", "init_policy", "run", "navigator.policy")
_RUN = "run "
# The key of a run, by its recipe and its settings.
_KeyOf = Callable[[str, Mapping[str, Any]], str]


def run_key(recipe: str, settings: Mapping[str, Any]) -> str:
    """A short word for all settings that a run's result depends on.

    ``settings`` are plain values, nested. A setting that is ``None`` counts as absent,
    and so does a new one with the number that was in code before, so that neither
    changes a key; another run is known by its own key and not by its folder.

    Examples:
        >>> one = run_key("explore", {"seed": 0, "threads": 1, "resume": None})
        >>> one == run_key("explore", {"seed": 0, "threads": 2})
        True
        >>> one == run_key("explore", {"seed": 1, "threads": 1})
        False
    """
    values = {
        name: _key_of_other(value) if name in OTHER_RUNS else value
        for name, value in _flat(settings)
        if name not in _NOT_RESULTS and value not in (None, _FORMER.get(name))
    }
    if _WORDS in values:
        values[_WORDS] = [one for one in values[_WORDS] if _matters(one)]
    text = json.dumps([recipe, values], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _matters(word: str) -> bool:
    """Whether a run's result depends on a word of a command line."""
    return word.partition("=")[0].lstrip("+") not in _NOT_RESULTS


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _key_of_other(value: str) -> str:
    folder = Path(value)
    folder = folder if folder.is_dir() else folder.parent
    return next((f"{_RUN}{key}" for _, key in read_keys([folder])), value)


def named_run(key: str) -> str:
    """What stands for the folder of a run that may not be there yet."""
    return f"{_RUN}{key}"


def read_keys(
    folders: list[Path], key_of: _KeyOf = run_key
) -> Iterator[tuple[Path, str]]:
    """Folder and key of each of these folders that is a run with readable settings."""
    for folder in folders:
        saved = folder / "config"
        if not (saved / "config.yaml").is_file():
            continue
        # A damaged one is nobody's run, and neither is one of an earlier version.
        with suppress(SettingsError, ValueError, AttributeError):
            recipe = OmegaConf.select(
                read_yaml(saved / "hydra.yaml"), "hydra.job.config_name"
            )
            if recipe in ("explore", "pretrain", "navigate"):
                yield folder, key_of(recipe, plain(read_yaml(saved / "config.yaml")))


def plain(config: DictConfig) -> dict[str, Any]:
    """Settings as nested plain values, interpolations resolved."""
    found: Any = OmegaConf.to_container(config, resolve=True)
    return dict(found)


def find_keys(runs: Path) -> dict[str, Path]:
    """The run of each key in a folder of runs, finished ones before others."""
    folders = sorted(folders_of_runs(runs, "runs"))
    found: dict[str, Path] = {}
    for folder, key in read_keys(folders):
        if key not in found or (not is_finished(found[key]) and is_finished(folder)):
            found[key] = folder
    return found


def find_mapped(runs: Path) -> dict[str, Path]:
    """The finished explorations that grew a map, by their keys if they had grown none.

    The map follows the agent and changes nothing of where it goes.
    """
    folders = sorted(folders_of_runs(runs, "runs"))
    found = read_keys(folders, _key_without_map)
    return {key: folder for folder, key in found if key and is_finished(folder)}


def _key_without_map(recipe: str, settings: Mapping[str, Any]) -> str:
    """The key that an exploration would have without its map; empty for others."""
    of_map, of_head = (settings.get(name) or {} for name in ("map", "locomotion"))
    if recipe != "explore" or not of_map.get("grow"):
        return ""
    off = {"map": {**of_map, "grow": False}, "locomotion": {**of_head, "learn": False}}
    return run_key(recipe, {**settings, **off})


def is_finished(folder: Path, *, networks: bool = True) -> bool:
    """Whether a run has left its results, and no later start of it goes on.

    Without ``networks`` its tables are enough, for which a run is kept.
    """
    try:
        if (folder / "evaluation.csv").is_file():
            read_exploration(folder)
            return _is_over(folder)
        if (folder / "summary.csv").is_file():
            read_navigation(folder)
            return True
        read_pretraining(folder)
        if not _is_over(folder):
            return False
    except (BrokenRunError, SettingsError):
        return False
    return not networks or (folder / NETWORKS_FILE).is_file()


def _is_over(folder: Path) -> bool:
    """Whether a run has reported the last of what it was to learn from.

    One that goes on with more has the results of less.
    """
    config = read_yaml(folder / "config" / "config.yaml")
    updates = _number(config, "train.updates")
    if updates is not None:
        return _last(folder, "update") >= updates
    minutes = _number(config, "collect.minutes")
    # Of the seconds the table has six digits.
    if minutes is not None and _last(folder, "seconds") >= 59.999 * minutes:
        return True
    return decisions_of(folder) >= (_number(config, "collect.decisions") or 0)


def _number(config: DictConfig, name: str) -> float | None:
    found = OmegaConf.select(config, name)
    if found is not None and not isinstance(found, int | float):
        raise BrokenRunError(f"has no number as {name} in its settings")
    return found


def decisions_of(folder: Path) -> float:
    """Decisions that an exploration has reported, 0 before it does."""
    return _last(folder, "decisions")


def _last(folder: Path, column: str) -> float:
    """The last value of a column of ``metrics.csv``, 0 before it has one."""
    with suppress(BrokenRunError, ValueError):
        return float(read_table(folder / "metrics.csv", (column,))[column].iloc[-1])
    return 0.0


def seconds_of(folder: Path) -> float:
    """Seconds that a finished run took, its pre-training left out; NaN if unknown."""
    with suppress(BrokenRunError, ValueError):
        if (folder / "phases.csv").is_file():
            phases = read_table(folder / "phases.csv", ("phase", "seconds"))
            return float(phases["seconds"][phases["phase"] != "pre-train"].sum())
        table = read_table(folder / "metrics.csv", ("seconds",))
        return float(table["seconds"].iloc[-1])
    return math.nan
