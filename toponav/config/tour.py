"""The schema of ``recipes/tour.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import require
from toponav.config.maze import MazeConfig


@dataclass
class TourConfig:
    """Settings of ``recipes/tour.py``."""

    engine: str = MISSING
    maze: MazeConfig = MISSING
    seed: int = MISSING
    decisions: int = MISSING
    views: int = MISSING
    video: str = MISSING
    height: int = MISSING

    def __post_init__(self) -> None:
        require(self.video in ("mp4", "gif"), "video must be mp4 or gif", self.video)
        require(self.height >= 64, "height must be at least 64 pixels", self.height)
        require(self.decisions >= 1, "decisions must be at least 1", self.decisions)
        require(1 <= self.views <= 12, "views must lie in [1, 12]", self.views)
