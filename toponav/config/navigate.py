"""The schema of ``recipes/navigate.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import (
    require,
    require_at_least,
    require_between,
    require_choice,
)
from toponav.config.maze import MazeConfig


@dataclass
class NavigatorConfig:
    """A navigator (``conf/navigator``); its own settings are beside its method."""

    name: str = MISSING


@dataclass
class GoalsConfig:
    """The pictures by which the agent knows its goal."""

    views: int = MISSING
    source: str = MISSING

    def __post_init__(self) -> None:
        require_between("goals.views", self.views, 1, 16)
        require_choice("goals.source", self.source, ("map", "walk"))


@dataclass
class NavigateEvaluateConfig:
    """The episodes, and who plays them."""

    episodes: int = MISSING
    policies: list[str] = MISSING
    slow: int = MISSING

    def __post_init__(self) -> None:
        require_at_least("evaluate.episodes", self.episodes, 1)
        require_at_least("evaluate.slow", self.slow, 1)
        require(len(self.policies) > 0, "evaluate.policies must name one", "none")


@dataclass
class NavigateVideoConfig:
    """The video of the agent's first episode."""

    decisions: int = MISSING
    format: str = MISSING
    height: int = MISSING

    def __post_init__(self) -> None:
        require_at_least("video.decisions", self.decisions, 0)
        require_choice("video.format", self.format, ("mp4", "gif"))
        require_at_least("video.height", self.height, 64)


@dataclass
class NavigateConfig:
    """Settings of ``recipes/navigate.py``."""

    engine: str = MISSING
    maze: MazeConfig = MISSING
    navigator: NavigatorConfig = MISSING
    goals: GoalsConfig = MISSING
    evaluate: NavigateEvaluateConfig = MISSING
    video: NavigateVideoConfig = MISSING
    run: str | None = MISSING
    seed: int = MISSING
    threads: int | None = MISSING

    def __post_init__(self) -> None:
        require(
            self.maze.goal, "maze.goal must be true, so that there is a goal", False
        )
        if self.threads is not None:
            require_at_least("threads", self.threads, 1)
