"""The schema of ``recipes/tour.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import Settings, at_least, between, one_of
from toponav.config.maze import MazeConfig


@dataclass
class TourConfig(Settings):
    """Settings of ``recipes/tour.py``."""

    engine: str = MISSING
    maze: MazeConfig = MISSING
    seed: int = MISSING
    decisions: int = at_least(1)
    views: int = between(1, 12)
    video: str = one_of("mp4", "gif")
    height: int = at_least(64)
