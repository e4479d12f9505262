"""The schema of ``recipes/practise.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import (
    MOST_THREADS,
    Settings,
    a_seed,
    above,
    at_least,
    between,
    require,
)
from toponav.config.groups import MazeConfig
from toponav.config.navigate import NavigatorConfig


@dataclass
class PracticeConfig(Settings):
    """How much is practised, and how the controller learns (``conf/practise``)."""

    group = "practice"
    decisions: int = at_least(1)
    envs: int = at_least(1)
    rollout: int = at_least(2)
    lr: float = above(0)
    gamma: float = between(0, 1)
    lmbda: float = between(0, 1)
    epochs: int = at_least(1)
    minibatch: int = at_least(2)
    clip_epsilon: float = above(0)
    entropy_coeff: float = at_least(0)
    confirm: float = between(0, 1)


@dataclass
class PractiseConfig(Settings):
    """Settings of ``recipes/practise.py``."""

    engine: str = MISSING
    maze: MazeConfig = MISSING
    navigator: NavigatorConfig = MISSING
    practice: PracticeConfig = MISSING
    run: str | None = MISSING
    seed: int = a_seed()
    threads: int | None = at_least(1, most=MOST_THREADS)

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = "maze.goal must be false: targets are the map's own"
        require(not self.maze.goal, rule, True)
