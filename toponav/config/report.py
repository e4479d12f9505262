"""The schema of ``recipes/report.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import Settings, at_least, require


@dataclass
class SweepReportConfig(Settings):
    """Settings of ``recipes/report.py``."""

    folder: str = MISSING
    draws: int = at_least(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            bool(self.folder),
            "folder must name the folder of a sweep, such as multirun/explore/<time>",
            f"'{self.folder}'",
        )
