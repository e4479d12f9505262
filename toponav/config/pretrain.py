"""The schema of ``recipes/pretrain.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import (
    MOST_GB,
    MOST_PAIRS,
    MOST_THREADS,
    Settings,
    a_seed,
    above,
    at_least,
    one_of,
    require,
)
from toponav.config.groups import MazeConfig, ModelConfig, PairsConfig, WorldConfig

#: Most held-out episodes of a maze, each of which has an engine of its own, and most
#: views of them, all of which are kept in memory.
_MOST_EPISODES, _MOST_VIEWS = 1024, 1_000_000


@dataclass
class CollectConfig(Settings):
    """Where the frames of pre-training come from."""

    group = "collect"
    decisions: int = at_least(1)
    buffer_gb: float = above(0, most=MOST_GB)
    ahead: int = at_least(1)
    share: float = above(0, most=1)
    workers: int = at_least(1)
    envs: int = at_least(1)
    batch: int = at_least(1)
    policy: str = one_of("uniform", "sticky")
    max_idle_s: int = at_least(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = f"collect.batch must be a multiple of collect.envs={self.envs}"
        require(self.batch % self.envs == 0, rule, self.batch)


@dataclass
class TrainConfig(Settings):
    """How the networks are trained."""

    group = "train"
    updates: int = at_least(0)
    lr: float = above(0)
    weight_decay: float = at_least(0)
    warmup: int = at_least(0)
    schedule: str = one_of("cosine", "constant")
    locomotion_coeff: float = at_least(0)
    max_grad_norm: float = above(0)
    bf16: bool = MISSING
    threads: int | None = at_least(1, most=MOST_THREADS)
    save_every_s: float = above(0)


@dataclass
class ValidateConfig(Settings):
    """What the networks are measured on."""

    group = "validate"
    episodes: int = at_least(1, most=_MOST_EPISODES)
    decisions: int = at_least(1)
    pairs: int = at_least(1, most=MOST_PAIRS)
    every: int = at_least(1)
    m: int = at_least(2)

    def __post_init__(self) -> None:
        super().__post_init__()
        views, rule = self.episodes * self.decisions, "validate.episodes * "
        rule += f"validate.decisions must be at most {_MOST_VIEWS:,} views of each maze"
        require(views <= _MOST_VIEWS, rule, views)


@dataclass
class PretrainConfig(Settings):
    """Settings of ``recipes/pretrain.py``."""

    world: WorldConfig = MISSING
    engine: str = MISSING
    maze: MazeConfig = MISSING
    mazes: list[str] = MISSING
    model: ModelConfig = MISSING
    collect: CollectConfig = MISSING
    pairs: PairsConfig = MISSING
    train: TrainConfig = MISSING
    validate: ValidateConfig = MISSING
    seed: int = a_seed()
    device: str = MISSING
    init_from: str | None = MISSING
    resume: str | None = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.train.updates > 0 or bool(self.init_from or self.resume),
            "init_from must name a run when train.updates=0",
            self.init_from,
        )
        rows = self.collect.envs * self.collect.workers
        lengths = {
            f"{self.world.group}.episode_length": self.world.episode_length,
            "validate.decisions": self.validate.decisions,
            "collect.ahead / (workers * envs)": self.collect.ahead // rows,
        }
        self.pairs.check_room(lengths, self.longest_m)
        ahead, most = self.collect.ahead, self.collect.decisions
        rule = f"collect.ahead must be at most collect.decisions={most}"
        require(ahead <= most, rule, ahead)

    @property
    def longest_m(self) -> int:
        """The larger M, of training and validation."""
        return max(self.pairs.m, self.validate.m)
