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
    """How the agent finds its place, plans, walks and gives up."""

    tc_reach: float | None = MISSING
    unwalked_cost: float = MISSING
    hops: int = MISSING
    window: int = MISSING
    shortlist: int | None = MISSING
    hysteresis: bool = MISSING
    follow: int = MISSING
    lookahead: int = MISSING
    temperature: float = MISSING
    avoid_futile: bool = MISSING
    block_after: int | None = MISSING
    keep_cuts: bool = MISSING
    fade_after: int | None = MISSING
    goal_patience: int | None = MISSING
    lost_for: int = MISSING

    def __post_init__(self) -> None:
        if self.tc_reach is not None:
            require_between("navigator.tc_reach", self.tc_reach, 0, 0.9999)
        if self.shortlist is not None:
            require_at_least("navigator.shortlist", self.shortlist, 1)
        for name in ("hops", "window", "lookahead", "lost_for"):
            require_at_least(f"navigator.{name}", getattr(self, name), 1)
        for name, least in (
            ("block_after", 2),
            ("fade_after", 1),
            ("goal_patience", 1),
        ):
            if (value := getattr(self, name)) is not None:
                require_at_least(f"navigator.{name}", value, least)
        require_at_least("navigator.follow", self.follow, 0)
        require_at_least("navigator.temperature", self.temperature, 0)
        require_at_least("navigator.unwalked_cost", self.unwalked_cost, 1)


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
    """The episodes, and who plays them beside the agent."""

    episodes: int = MISSING
    policies: list[str] = MISSING
    slow: int = MISSING

    def __post_init__(self) -> None:
        require_at_least("evaluate.episodes", self.episodes, 1)
        require_at_least("evaluate.slow", self.slow, 1)
        require(len(self.policies) > 0, "evaluate.policies must name one", "none")
        for name in self.policies:
            choices = ("navigator", "oracle", "random")
            require_choice("evaluate.policies", name, choices)


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
