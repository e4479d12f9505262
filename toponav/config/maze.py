"""The schema of a maze (``conf/maze``)."""

from dataclasses import dataclass, field

from omegaconf import MISSING

from toponav.config.checks import require


@dataclass
class MazeConfig:
    """A maze and what its episodes hold (``conf/maze``)."""

    name: str = MISSING
    path: str | None = MISSING
    rows: int = MISSING
    cols: int = MISSING
    seed: int = MISSING
    loops: float = MISSING
    apples: int = MISSING
    goal: bool = MISSING
    blocked: list[str] = field(default_factory=list)
    episode_length: int = MISSING
    texture_seed: int = MISSING
    paintings: float = MISSING
    marks: float = MISSING

    def __post_init__(self) -> None:
        require(self.rows >= 1, "maze.rows must be at least 1", self.rows)
        require(self.cols >= 1, "maze.cols must be at least 1", self.cols)
        require(0 <= self.loops <= 1, "maze.loops must lie in [0, 1]", self.loops)
        require(self.apples >= 0, "maze.apples must be at least 0", self.apples)
        require(
            self.episode_length >= 1,
            "maze.episode_length must be at least 1 decision",
            self.episode_length,
        )
        for name, share in (("paintings", self.paintings), ("marks", self.marks)):
            require(0 <= share <= 1, f"maze.{name} must lie in [0, 1]", share)
        require(
            self.name != "file" or bool(self.path),
            "maze.path must name a layout file when maze=file",
            self.path,
        )
