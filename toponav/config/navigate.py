"""The schemas of the recipes that run no training: navigate, tour and report."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from omegaconf import MISSING, DictConfig, OmegaConf

from toponav.config.checks import (
    MOST_DRAWS,
    MOST_THREADS,
    Settings,
    a_seed,
    at_least,
    between,
    one_of,
    read_yaml,
    require,
)
from toponav.config.groups import MazeConfig

_NONE = object()


@dataclass
class NavigatorConfig(Settings):
    """A navigator (``conf/navigator``); its own settings are beside its method."""

    group = "navigator"
    name: str = MISSING


@dataclass
class GoalsConfig(Settings):
    """The pictures by which the agent knows its goal."""

    group = "goals"
    views: int = between(1, 16)
    source: str = one_of("map", "walk")


@dataclass
class NavigateEvaluateConfig(Settings):
    """The episodes, and who plays them."""

    group = "evaluate"
    episodes: int = at_least(1)
    policies: list[str] = MISSING
    trained: list[str] = MISSING
    slow: int = at_least(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.policies) > 0, "evaluate.policies must name one", "none")
        for entry in self.trained:
            name, _, folder = entry.partition(":")
            rule = "evaluate.trained must hold entries such as dqn:runs/explore/dqn"
            require(bool(name and folder), rule, f"'{entry}'")


@dataclass
class NavigateVideoConfig(Settings):
    """The video of the agent's first episode."""

    group = "video"
    decisions: int = at_least(0)
    format: str = one_of("mp4", "gif")
    height: int = between(64, 4320)


@dataclass
class NavigateConfig(Settings):
    """Settings of ``recipes/navigate.py``."""

    engine: str = MISSING
    maze: MazeConfig = MISSING
    navigator: NavigatorConfig = MISSING
    goals: GoalsConfig = MISSING
    evaluate: NavigateEvaluateConfig = MISSING
    video: NavigateVideoConfig = MISSING
    run: str | None = MISSING
    seed: int = a_seed()
    threads: int | None = at_least(1, most=MOST_THREADS)

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = "maze.goal must be true, so that there is a goal"
        require(self.maze.goal, rule, False)


@dataclass
class TourConfig(Settings):
    """Settings of ``recipes/tour.py``."""

    engine: str = MISSING
    maze: MazeConfig = MISSING
    seed: int = a_seed()
    decisions: int = at_least(1)
    views: int = between(1, 12)
    video: str = one_of("mp4", "gif")
    height: int = between(64, 4320)

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = (
            f"views must be at most decisions ({self.decisions}), which has a view each"
        )
        require(self.views <= self.decisions, rule, self.views)


@dataclass
class SweepReportConfig(Settings):
    """Settings of ``recipes/report.py``."""

    folder: str = MISSING
    draws: int = at_least(1, most=MOST_DRAWS)

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = "folder must name the folder of a sweep, such as multirun/explore/<time>"
        require(bool(self.folder), rule, f"'{self.folder}'")


def run_setting(run: str | None, name: str, default: Any = _NONE) -> Any:
    """A setting, by its dotted name, of the exploration in a run folder.

    YAML writes it ``${run_setting:${run},maze.name}``. The default stands for that of
    no run, and of earlier runs that had no such setting.

    Raises:
        SettingsError: if it is no folder of an exploration, or has no such setting.
    """
    if run is None and default is not _NONE:
        return default
    rule = "run must name the folder of an exploration"
    require(run is not None, rule, "none")
    file = Path(str(run)) / "config" / "config.yaml"
    require(file.is_file(), rule, f"'{run}'")
    stat = file.stat()
    config = _saved(file, stat.st_ino, stat.st_mtime_ns, stat.st_size)
    explored = {"maze", "reward"} <= config.keys()
    require(explored, rule, f"that of another recipe, '{run}'")
    value = OmegaConf.select(config, name, default=default)
    rule, old = f"{rule} of this version", "which an earlier version made with other"
    require(value is not _NONE, rule, f"'{run}', {old} settings, without {name}")
    return value


# A command line asks for ten settings of a run and its start for more, one by one, and
# reading the file takes longer than all else. Another version of it is another entry.
@lru_cache(maxsize=4)
def _saved(file: Path, _inode: int, _time: int, _size: int) -> DictConfig:
    """The settings of a run; nobody changes them."""
    return read_yaml(file)
