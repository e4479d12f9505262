"""The schema of ``recipes/report.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import require, require_at_least


@dataclass
class SweepReportConfig:
    """Settings of ``recipes/report.py``."""

    folder: str = MISSING
    draws: int = MISSING

    def __post_init__(self) -> None:
        require(
            bool(self.folder),
            "folder must name the folder of a sweep, such as multirun/explore/<time>",
            f"'{self.folder}'",
        )
        require_at_least("draws", self.draws, 1)
