"""The schema of a maze (``conf/maze``)."""

from dataclasses import dataclass, field

from omegaconf import MISSING

from toponav.config.checks import Settings, at_least, between, require


@dataclass
class MazeConfig(Settings):
    """A maze and what its episodes hold (``conf/maze``)."""

    group = "maze"
    name: str = MISSING
    path: str | None = MISSING
    rows: int = at_least(1)
    cols: int = at_least(1)
    seed: int = MISSING
    loops: float = between(0, 1)
    apples: int = at_least(0)
    goal: bool = MISSING
    blocked: list[str] = field(default_factory=list)
    episode_length: int = at_least(1)
    texture_seed: int = MISSING
    paintings: float = between(0, 1)
    marks: float = between(0, 1)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.name != "file" or bool(self.path),
            "maze.path must name a layout file when maze=file",
            self.path,
        )
