"""The schemas of the groups that several recipes have.

The settings of one method alone are beside the method, in ``toponav/methods``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from omegaconf import MISSING

from toponav.config.checks import (
    MOST_PAIRS,
    Settings,
    a_seed,
    above,
    at_least,
    between,
    one_of,
    require,
)

#: Most junctions of a side of a random maze: two cells each, and the last wall
#: (`toponav.envs`).
_MOST_JUNCTIONS = 50


@dataclass
class MazeConfig(Settings):
    """A maze and what its episodes hold (``conf/maze``)."""

    group = "maze"
    name: str = MISSING
    path: str | None = MISSING
    rows: int = at_least(1, most=_MOST_JUNCTIONS)
    cols: int = at_least(1, most=_MOST_JUNCTIONS)
    seed: int = a_seed()
    loops: float = between(0, 1)
    apples: int = at_least(0)
    goal: bool = MISSING
    blocked: list[str] = field(default_factory=list)
    episode_length: int = at_least(1)
    texture_seed: int = a_seed()
    paintings: float = between(0, 1)
    marks: float = between(0, 1)

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = "maze.path must name a layout file when maze=file"
        require(self.name != "file" or bool(self.path), rule, self.path)


def maze_label(name: str, path: str | None) -> str:
    """What folders and pictures call a maze: a layout of one's own by its file.

    Examples:
        >>> maze_label("file", "/layouts/office.txt"), maze_label("maze1", None)
        ('office', 'maze1')
    """
    return Path(path).stem if name == "file" and path else name


@dataclass
class RewardConfig(Settings):
    """A reward method (``conf/reward``)."""

    group = "reward"
    name: str = MISSING


@dataclass
class LearnerConfig(Settings):
    """A learner (``conf/loss``)."""

    group = "loss"
    name: str = MISSING
    lr: float = above(0)
    final_lr: float = between(0, 1)
    rollout: int = at_least(1)
    max_grad_norm: float = above(0)

    def check(self, num_envs: int) -> None:
        """Refuse settings that do not fit the number of environments."""


@dataclass
class WorldConfig(Settings):
    """A world (``conf/world``)."""

    group = "world"
    name: str = MISSING
    label: str = MISSING
    episode_length: int = at_least(1)


@dataclass
class ModelConfig(Settings):
    """The TC-network and the L-network (``conf/model``)."""

    group = "model"
    encoder: str = one_of("small", "resnet18")
    embedding_dim: int = at_least(1)
    batch_norm: bool = MISSING
    share_encoder: bool = MISSING
    comparator: str = one_of("concat", "difference")
    projection_dim: int = at_least(1)
    comparator_hidden: list[int] = MISSING
    locomotion_hidden: list[int] = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        rule, widths = "must be a list of widths of at least 1", self.comparator_hidden
        require(min(widths, default=0) >= 1, f"model.comparator_hidden {rule}", widths)
        rule, widths = "must hold widths of at least 1", self.locomotion_hidden
        require(min(widths, default=1) >= 1, f"model.locomotion_hidden {rule}", widths)
        rule, norm = "must be true with the encoder resnet18", self.batch_norm
        require(norm or self.encoder == "small", f"model.batch_norm {rule}", norm)

    @property
    def halve(self) -> bool:
        """Whether views are halved for the networks: all that `small` looks at."""
        return self.encoder == "small"


@dataclass
class PairsConfig(Settings):
    """Which pairs of views train the networks."""

    group = "pairs"
    k: int = at_least(1)
    m: int = at_least(2)
    locomotion_k: int = at_least(1)
    locomotion_exact: bool = MISSING
    other_episode_share: float = between(0, 1)
    mined: bool = MISSING
    per_update: int = at_least(1, most=MOST_PAIRS)
    episodes: int = at_least(1)
    chunks: int = at_least(1)
    chunk_len: int = at_least(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        longest, length = max(self.k, self.locomotion_k), self.chunk_len
        rule = "pairs.chunk_len must be more than pairs.k and pairs.locomotion_k"
        require(not self.mined or length > longest, f"{rule}, {longest}", length)
        rule, number = "pairs.per_update must be at least 2", self.per_update
        require(not self.mined or number > 1, f"{rule} with pairs.mined=true", number)

    def check_room(self, lengths: Mapping[str, int], m: int) -> None:
        """Refuse what has no room for a pair, the longest of M = ``m``."""
        longest = max(self.k * m, self.locomotion_k)
        for name, length in lengths.items():
            rule = f"{name} must be more than M * k = {longest} decisions"
            require(length > longest, rule, length)
