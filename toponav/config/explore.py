"""The schema of ``recipes/explore.py``."""

from dataclasses import dataclass, replace

from omegaconf import MISSING

from toponav.config.checks import (
    require,
    require_above_zero,
    require_at_least,
    require_between,
    require_choice,
    require_threshold,
)
from toponav.config.maze import MazeConfig
from toponav.config.methods import LearnerConfig, RewardConfig, WorldConfig
from toponav.config.model import ModelConfig, PairsConfig


@dataclass
class PolicyConfig:
    """The explorer's network."""

    input: str = MISSING
    view_size: int = MISSING
    hidden: int = MISSING

    def __post_init__(self) -> None:
        require_choice("policy.input", self.input, ("auto", "embedding", "pixels"))
        require_at_least("policy.view_size", self.view_size, 36)
        require_at_least("policy.hidden", self.hidden, 1)


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
    weight_decay: float = MISSING
    locomotion_coeff: float = MISSING
    every: int = MISSING
    publish_every: int = MISSING
    ahead: int = MISSING
    buffer_gb: float = MISSING

    def __post_init__(self) -> None:
        require_above_zero("online.lr", self.lr)
        for name in ("weight_decay", "locomotion_coeff"):
            require_at_least(f"online.{name}", getattr(self, name), 0)
        for name in ("every", "publish_every", "ahead"):
            require_at_least(f"online.{name}", getattr(self, name), 1)
        require_above_zero("online.buffer_gb", self.buffer_gb)


@dataclass
class LocomotionConfig:
    """What the L-network's head learns from the paths that the explorers took."""

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
    window: int = MISSING
    search_window: int = MISSING
    surroundings: int = MISSING
    surroundings_above: float = MISSING
    hysteresis: bool = MISSING
    nearby: int | None = MISSING
    shortlist: int | None = MISSING
    untraversed_edge_cost: float = MISSING
    sparsify: float | None = MISSING

    def __post_init__(self) -> None:
        for name in ("tc_threshold", "tc_reach"):
            require_threshold(f"map.{name}", getattr(self, name), ("auto",))
        require_choice("map.edges", self.edges, ("both", "reach", "time"))
        require_choice("map.extend_by", self.extend_by, ("itself", "previous"))
        for name in ("window", "search_window", "surroundings"):
            require_at_least(f"map.{name}", getattr(self, name), 0)
        require_at_least("map.after", self.after, 0)
        require_between("map.surroundings_above", self.surroundings_above, 0, 0.999)
        for name in ("envs", "nearby", "shortlist"):
            if (value := getattr(self, name)) is not None:
                require_at_least(f"map.{name}", value, 1)
        require_at_least("map.untraversed_edge_cost", self.untraversed_edge_cost, 1)
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

    world: WorldConfig = MISSING
    engine: str = MISSING
    maze: MazeConfig = MISSING
    model: ModelConfig = MISSING
    pairs: PairsConfig = MISSING
    reward: RewardConfig = MISSING
    policy: PolicyConfig = MISSING
    loss: LearnerConfig = MISSING
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
        self.loss.check(self.collect.envs)
        require(
            self.collect.envs * self.loss.rollout <= self.collect.decisions,
            "collect.decisions must be at least collect.envs * loss.rollout = "
            f"{self.collect.envs * self.loss.rollout}, one batch",
            self.collect.decisions,
        )
        require(
            self.locomotion.k < self.world.episode_length,
            f"locomotion.k must be less than {self.world.length_setting} = "
            f"{self.world.episode_length} decisions",
            self.locomotion.k,
        )
        require(
            not self.map.grow or self.map.after < self.collect.decisions,
            f"map.after must be less than collect.decisions = {self.collect.decisions}",
            self.map.after,
        )
        longest = max(self.pairs.k * self.pairs.m, self.pairs.locomotion_k)
        require(
            self.world.episode_length > longest,
            f"{self.world.length_setting} must be more than M * k = "
            f"{longest} decisions",
            self.world.episode_length,
        )

    def resolved(self, model: ModelConfig | None) -> "ExploreConfig":
        """These settings with the model of its networks, and ``policy.input`` set.

        Args:
            model: of the networks; ``None`` in a run without.

        Raises:
            SettingsError: if the policy should see embeddings that nobody makes.
        """
        automatic = "pixels" if model is None else "embedding"
        view = automatic if self.policy.input == "auto" else self.policy.input
        require(
            view == "pixels" or model is not None,
            "policy.input must be pixels in a run without networks (reward="
            f"{self.reward.name} and no pretrained)",
            view,
        )
        policy = replace(self.policy, input=view)
        return replace(self, model=model or self.model, policy=policy)
