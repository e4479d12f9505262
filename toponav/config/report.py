"""The schema of ``recipes/report.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import require


@dataclass
class SweepReportConfig:
    """Settings of ``recipes/report.py``."""

    folder: str = MISSING

    def __post_init__(self) -> None:
        require(
            bool(self.folder),
            "folder must name the folder of a sweep, such as multirun/explore/<time>",
            f"'{self.folder}'",
        )
