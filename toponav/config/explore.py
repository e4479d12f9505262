"""The schema of ``recipes/explore.py``."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import (
    require,
    require_above_zero,
    require_at_least,
    require_between,
    require_choice,
)
from toponav.config.maze import MazeConfig
from toponav.config.pretrain import ModelConfig, PairsConfig

_THRESHOLDS = ("auto", "tc")


@dataclass
class RewardConfig:
    """What the explorer is paid for."""

    kind: str = MISSING
    alpha: float = MISSING
    beta: float | None = MISSING
    threshold: str = MISSING
    floor: float = MISSING
    clip: float | None = MISSING
    combine: str = MISSING
    replacement: str = MISSING
    persistence: int = MISSING
    min_gap: int = MISSING
    count_on: str = MISSING
    capacity: int = MISSING
    aggregate: str = MISSING

    def __post_init__(self) -> None:
        require_choice("reward.kind", self.kind, ("intrinsic", "coverage"))
        require_between("reward.alpha", self.alpha, 0, 1)
        if self.beta is not None:
            require_at_least("reward.beta", self.beta, 0)
        if self.threshold not in _THRESHOLDS:
            try:
                number = float(self.threshold)
            except ValueError:
                require(
                    False,
                    f"reward.threshold must be one of {', '.join(_THRESHOLDS)} or a "
                    "number in [0, 0.999]",
                    self.threshold,
                )
            require_between("reward.threshold", number, 0, 0.999)
        require_between("reward.floor", self.floor, 0.001, 1)
        if self.clip is not None:
            require_above_zero("reward.clip", self.clip)
        require_choice("reward.combine", self.combine, ("exclusive", "sum"))
        for name in ("persistence", "min_gap", "capacity"):
            require_at_least(f"reward.{name}", getattr(self, name), 1)
        require_choice("reward.count_on", self.count_on, ("every", "entry"))
        choices = ("none", "oldest", "least_visited")
        require_choice("reward.replacement", self.replacement, choices)
        if self.aggregate != "max":
            require(
                _is_number(self.aggregate),
                "reward.aggregate must be max or a percentile in [0, 100]",
                self.aggregate,
            )
            require_between("reward.aggregate", float(self.aggregate), 0, 100)

    @property
    def weights(self) -> tuple[float, float]:
        """Alpha and beta; a beta that is not given is 1 - alpha."""
        return self.alpha, 1 - self.alpha if self.beta is None else self.beta


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


@dataclass
class PolicyConfig:
    """The explorer's network."""

    input: str = MISSING
    hidden: int = MISSING

    def __post_init__(self) -> None:
        require_choice("policy.input", self.input, ("embedding", "pixels"))
        require_at_least("policy.hidden", self.hidden, 1)


@dataclass
class LossConfig:
    """How the explorer learns from a batch."""

    kind: str = MISSING
    lr: float = MISSING
    final_lr: float = MISSING
    entropy_coeff: float = MISSING
    final_entropy: float = MISSING
    critic_coeff: float = MISSING
    gamma: float = MISSING
    lmbda: float = MISSING
    clip_epsilon: float = MISSING
    epochs: int = MISSING
    minibatches: int = MISSING
    sequence: int = MISSING
    rollout: int = MISSING
    max_grad_norm: float = MISSING
    normalize_returns: bool = MISSING
    decay: float = MISSING
    eps: float = MISSING

    def __post_init__(self) -> None:
        require_choice("loss.kind", self.kind, ("ppo", "a3c"))
        for name in ("lr", "max_grad_norm", "eps"):
            require_above_zero(f"loss.{name}", getattr(self, name))
        for name in ("final_lr", "final_entropy", "gamma", "lmbda", "decay"):
            require_between(f"loss.{name}", getattr(self, name), 0, 1)
        require_between("loss.clip_epsilon", self.clip_epsilon, 0.001, 1)
        for name in ("entropy_coeff", "critic_coeff"):
            require_at_least(f"loss.{name}", getattr(self, name), 0)
        for name in ("epochs", "minibatches", "sequence", "rollout"):
            require_at_least(f"loss.{name}", getattr(self, name), 1)
        require(
            self.kind != "ppo" or self.rollout % self.sequence == 0,
            f"loss.rollout must be a multiple of loss.sequence={self.sequence}",
            f"{self.rollout} (did you mean "
            f"{max(round(self.rollout / self.sequence), 1) * self.sequence}?)",
        )


@dataclass
class ExploreCollectConfig:
    """Where the explorer's decisions come from."""

    mode: str = MISSING
    decisions: int = MISSING
    minutes: float | None = MISSING
    workers: int = MISSING
    envs: int = MISSING
    stagger: bool = MISSING
    noisy_tv: bool = MISSING
    max_idle_s: int = MISSING

    def __post_init__(self) -> None:
        require_choice("collect.mode", self.mode, ("async", "sync"))
        for name in ("decisions", "workers", "envs", "max_idle_s"):
            require_at_least(f"collect.{name}", getattr(self, name), 1)
        if self.minutes is not None:
            require_above_zero("collect.minutes", self.minutes)
        nearest = max(round(self.envs / self.workers), 1) * self.workers
        require(
            self.envs % self.workers == 0,
            f"collect.envs must be a multiple of collect.workers={self.workers}",
            f"{self.envs} (did you mean {nearest}?)",
        )


@dataclass
class OnlineConfig:
    """Whether and how TC-network and L-network go on learning."""

    learn: bool = MISSING
    lr: float = MISSING
    every: int = MISSING
    publish_every: int = MISSING
    ahead: int = MISSING
    buffer_gb: float = MISSING

    def __post_init__(self) -> None:
        require_above_zero("online.lr", self.lr)
        for name in ("every", "publish_every", "ahead"):
            require_at_least(f"online.{name}", getattr(self, name), 1)
        require_above_zero("online.buffer_gb", self.buffer_gb)


@dataclass
class LocomotionConfig:
    """What the L-network's head learns from the ways that the explorers took."""

    learn: bool = MISSING
    memory: int = MISSING
    k: int = MISSING
    updates: int = MISSING
    pairs: int = MISSING
    lr: float = MISSING

    def __post_init__(self) -> None:
        for name in ("memory", "k", "updates", "pairs"):
            require_at_least(f"locomotion.{name}", getattr(self, name), 1)
        require_above_zero("locomotion.lr", self.lr)


@dataclass
class MapConfig:
    """The topological map that grows while exploring."""

    grow: bool = MISSING
    after: int = MISSING
    envs: int | None = MISSING
    tc_threshold: str = MISSING
    tc_reach: str = MISSING
    edges: str = MISSING
    extend_by: str = MISSING
    link_transitions: bool = MISSING
    window: int = MISSING
    search_window: int = MISSING
    surroundings: int = MISSING
    surroundings_above: float = MISSING
    hysteresis: bool = MISSING
    nearby: int | None = MISSING
    shortlist: int | None = MISSING
    unwalked_cost: float = MISSING
    sparsify: float | None = MISSING

    def __post_init__(self) -> None:
        for name in ("tc_threshold", "tc_reach"):
            if (value := getattr(self, name)) != "auto":
                require(
                    _is_number(value),
                    f"map.{name} must be auto or a number in [0, 0.999]",
                    value,
                )
                require_between(f"map.{name}", float(value), 0, 0.999)
        require_choice("map.edges", self.edges, ("both", "reach", "time"))
        require_choice("map.extend_by", self.extend_by, ("itself", "previous"))
        for name in ("window", "search_window", "surroundings"):
            require_at_least(f"map.{name}", getattr(self, name), 0)
        require_at_least("map.after", self.after, 0)
        require_between("map.surroundings_above", self.surroundings_above, 0, 0.999)
        for name in ("envs", "nearby", "shortlist"):
            if (value := getattr(self, name)) is not None:
                require_at_least(f"map.{name}", value, 1)
        require_at_least("map.unwalked_cost", self.unwalked_cost, 1)
        if self.sparsify is not None:
            require_between("map.sparsify", self.sparsify, 0, 1)


@dataclass
class PretrainingConfig:
    """The pre-training that a run without networks starts with."""

    scale: str = MISSING
    maze: str | None = MISSING
    seed: int = MISSING
    folder: str = MISSING
    overrides: list[str] = MISSING


@dataclass
class ReportConfig:
    """How often a run says what it does."""

    every: int = MISSING
    pictures_every_s: float = MISSING
    save_every_s: float = MISSING
    best_of: int = MISSING

    def __post_init__(self) -> None:
        for name in ("every", "best_of"):
            require_at_least(f"report.{name}", getattr(self, name), 1)
        for name in ("pictures_every_s", "save_every_s"):
            require_above_zero(f"report.{name}", getattr(self, name))


@dataclass
class EvaluateConfig:
    """The episodes that a run is judged by at its end."""

    episodes: int = MISSING
    random_episodes: int = MISSING

    def __post_init__(self) -> None:
        require_at_least("evaluate.episodes", self.episodes, 1)
        require_at_least("evaluate.random_episodes", self.random_episodes, 1)


@dataclass
class ExploreConfig:
    """Settings of ``recipes/explore.py``."""

    maze: MazeConfig = MISSING
    model: ModelConfig = MISSING
    pairs: PairsConfig = MISSING
    reward: RewardConfig = MISSING
    policy: PolicyConfig = MISSING
    loss: LossConfig = MISSING
    collect: ExploreCollectConfig = MISSING
    online: OnlineConfig = MISSING
    locomotion: LocomotionConfig = MISSING
    map: MapConfig = MISSING
    pretraining: PretrainingConfig = MISSING
    report: ReportConfig = MISSING
    evaluate: EvaluateConfig = MISSING
    pretrained: str | None = MISSING
    seed: int = MISSING
    device: str = MISSING
    threads: int | None = MISSING
    resume: str | None = MISSING

    def __post_init__(self) -> None:
        if self.threads is not None:
            require_at_least("threads", self.threads, 1)
        require(
            self.collect.envs * self.loss.rollout <= self.collect.decisions,
            "collect.decisions must be at least collect.envs * loss.rollout = "
            f"{self.collect.envs * self.loss.rollout}, one batch",
            self.collect.decisions,
        )
        require(
            self.locomotion.k < self.maze.episode_length,
            "locomotion.k must be less than maze.episode_length = "
            f"{self.maze.episode_length} decisions",
            self.locomotion.k,
        )
        require(
            not self.map.grow or self.map.after < self.collect.decisions,
            f"map.after must be less than collect.decisions = {self.collect.decisions}",
            self.map.after,
        )
        longest = max(self.pairs.k * self.pairs.m, self.pairs.locomotion_k)
        require(
            self.maze.episode_length > longest,
            f"maze.episode_length must be more than M * k = {longest} decisions",
            self.maze.episode_length,
        )

    @property
    def halve(self) -> bool:
        """Whether the networks look at halved views: all that `small` looks at."""
        return self.model.encoder == "small"
