"""The schema of ``recipes/pretrain.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import require, require_at_least, require_choice
from toponav.config.maze import MazeConfig
from toponav.config.methods import WorldConfig
from toponav.config.model import ModelConfig, PairsConfig


@dataclass
class CollectConfig:
    """Where the frames of pre-training come from."""

    decisions: int = MISSING
    buffer_gb: float = MISSING
    ahead: int = MISSING
    share: float = MISSING
    workers: int = MISSING
    envs: int = MISSING
    batch: int = MISSING
    policy: str = MISSING

    def __post_init__(self) -> None:
        for name in ("decisions", "ahead", "workers", "envs", "batch"):
            require_at_least(f"collect.{name}", getattr(self, name), 1)
        require(0 < self.share <= 1, "collect.share must lie in (0, 1]", self.share)
        require_choice("collect.policy", self.policy, ("uniform", "sticky"))
        require(
            self.batch % self.envs == 0,
            f"collect.batch must be a multiple of collect.envs={self.envs}",
            self.batch,
        )
        require(self.buffer_gb > 0, "collect.buffer_gb must be above 0", self.buffer_gb)


@dataclass
class TrainConfig:
    """How the networks are trained."""

    updates: int = MISSING
    lr: float = MISSING
    weight_decay: float = MISSING
    warmup: int = MISSING
    schedule: str = MISSING
    locomotion_coeff: float = MISSING
    max_grad_norm: float = MISSING
    bf16: bool = MISSING
    threads: int | None = MISSING
    save_every_s: float = MISSING

    def __post_init__(self) -> None:
        require_at_least("train.updates", self.updates, 0)
        require_choice("train.schedule", self.schedule, ("cosine", "constant"))
        for name in ("lr", "max_grad_norm", "save_every_s"):
            value = getattr(self, name)
            require(value > 0, f"train.{name} must be above 0", value)
        for name in ("weight_decay", "warmup", "locomotion_coeff"):
            require_at_least(f"train.{name}", getattr(self, name), 0)
        if self.threads is not None:
            require_at_least("train.threads", self.threads, 1)


@dataclass
class ValidateConfig:
    """What the networks are measured on."""

    episodes: int = MISSING
    decisions: int = MISSING
    pairs: int = MISSING
    every: int = MISSING
    m: int = MISSING

    def __post_init__(self) -> None:
        for name in ("episodes", "decisions", "pairs", "every"):
            require_at_least(f"validate.{name}", getattr(self, name), 1)
        require_at_least("validate.m", self.m, 2)


@dataclass
class PretrainConfig:
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
    seed: int = MISSING
    device: str = MISSING
    init_from: str | None = MISSING
    resume: str | None = MISSING

    def __post_init__(self) -> None:
        require(
            self.train.updates > 0 or bool(self.init_from or self.resume),
            "init_from must name a run when train.updates=0",
            self.init_from,
        )
        longest = max(
            self.pairs.k * max(self.pairs.m, self.validate.m), self.pairs.locomotion_k
        )
        rows = self.collect.envs * self.collect.workers
        shortest = {
            self.world.length_setting: self.world.episode_length,
            "validate.decisions": self.validate.decisions,
            "collect.ahead / (workers * envs)": self.collect.ahead // rows,
        }
        for name, length in shortest.items():
            require(
                length > longest,
                f"{name} must be more than M * k = {longest} decisions",
                length,
            )
        require(
            self.collect.ahead <= self.collect.decisions,
            f"collect.ahead must be at most collect.decisions={self.collect.decisions}",
            self.collect.ahead,
        )
