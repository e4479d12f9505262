"""The schema of ``recipes/explore.py``."""

from dataclasses import dataclass, replace
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import MISSING

from toponav.config.checks import (
    MOST_GB,
    MOST_PAIRS,
    MOST_THREADS,
    Settings,
    SettingsError,
    a_seed,
    above,
    at_least,
    between,
    one_of,
    require,
    require_multiple,
    threshold_or,
)
from toponav.config.groups import (
    LearnerConfig,
    MazeConfig,
    ModelConfig,
    PairsConfig,
    RewardConfig,
    WorldConfig,
)

#: Decisions before and after a view that may count for the map: it waits for them, and
#: as long as it waits, what judges it keeps where the view was taken.
MOST_AROUND = 8192
#: Largest LSTM: a layer of so many units has 8.6 GB of weights.
_MOST_HIDDEN, _MOST_LAYERS = 16_384, 64
#: Of the command line of a pre-training, what says where and of what it is one.
_OWN = ("model", "world", "scale", "resume")
#: Most episodes of a policy, all of whose tables are kept in memory.
_MOST_EPISODES = 100_000


@dataclass
class PolicyConfig(Settings):
    """The explorer's network."""

    group = "policy"
    input: str = one_of("auto", "embedding", "pixels")
    view_size: int = at_least(36)
    hidden: int = at_least(1, most=_MOST_HIDDEN)
    layers: int = at_least(1, most=_MOST_LAYERS, default=1)


@dataclass
class ExploreCollectConfig(Settings):
    """Where the explorer's decisions come from."""

    group = "collect"
    backend: str = one_of("local", "ray")
    mode: str = one_of("async", "sync")
    device: str | None = MISSING
    decisions: int = at_least(1)
    minutes: float | None = above(0)
    workers: int = at_least(1)
    envs: int = at_least(1)
    stagger: bool = MISSING
    noisy_tv: bool = MISSING
    max_idle_s: int = at_least(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_multiple("collect.envs", self.envs, "collect.workers", self.workers)
        here = self.backend == "local" or self.device in (None, "cpu")
        rule = "collect.device must be null or cpu with collect.backend=ray"
        require(here, rule, f"'{self.device}'")


@dataclass
class RayConfig(Settings):
    """The machines that collect with ``collect.backend=ray``."""

    group = "ray"
    address: str | None = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        host, _, port = (self.address or "localhost:0").rpartition(":")
        good = bool(host) and "/" not in host and port.isdigit() and int(port) < 2**16
        rule = "ray.address must be null or the <host>:<port> of a Ray cluster"
        require(good, rule, f"'{self.address}'")


@dataclass
class OnlineConfig(Settings):
    """Whether and how TC-network and L-network continue training."""

    group = "online"
    learn: bool = MISSING
    lr: float = above(0)
    weight_decay: float = at_least(0)
    locomotion_coeff: float = at_least(0)
    every: int = at_least(1)
    publish_every: int = at_least(1)
    ahead: int = at_least(1)
    buffer_gb: float = above(0, most=MOST_GB)


@dataclass
class LocomotionConfig(Settings):
    """What the L-network's head learns from the paths that the explorers took."""

    group = "locomotion"
    learn: bool | None = MISSING
    memory: int = at_least(1)
    k: int = at_least(1)
    updates: int = at_least(1)
    pairs: int = at_least(1, most=MOST_PAIRS)
    lr: float = above(0)
    weight_decay: float = at_least(0)


@dataclass
class MapConfig(Settings):
    """The topological map that grows while exploring."""

    group = "map"
    grow: bool = MISSING
    after: int = at_least(0)
    envs: int | None = at_least(1)
    tc_threshold: str = threshold_or("auto")
    tc_reach: str = threshold_or("auto")
    edges: str = one_of("both", "reach", "time")
    edge_steps: int = at_least(1)
    extend_by: str = one_of("itself", "previous")
    window: int = between(0, MOST_AROUND)
    search_window: int = between(0, MOST_AROUND)
    surroundings: int = between(0, MOST_AROUND)
    surroundings_above: float = between(0, 0.999)
    turn_tolerance: float | None = between(0, 180)
    edge_threshold: float | None = between(0, 0.999)
    edge_gap: int = at_least(1)
    hysteresis: bool = MISSING
    nearby: int | None = at_least(1)
    shortlist: int | None = at_least(1)
    untraversed_edge_cost: float = at_least(1)
    capacity: int | None = at_least(1)
    sparsify: float | None = between(0, 1)
    poses: bool = MISSING
    poses_within: float = at_least(1)
    poses_above: float = between(0, 0.999)


@dataclass
class PretrainingConfig(Settings):
    """The pre-training that a run without networks starts with."""

    group = "pretraining"
    scale: str = MISSING
    maze: str | None = MISSING
    seed: int = a_seed()
    folder: str = MISSING
    overrides: list[str] = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        self.given()

    def given(self) -> dict[str, Any]:
        """Names and values of the settings in `overrides`, the last value of each.

        Raises:
            SettingsError: if one of the words is no setting with one value, or one
                that an exploration gives to its pre-training.
        """
        read: dict[str, Any] = {}
        rule = "pretraining.overrides must hold words such as train.lr=0.001"
        for word in self.overrides:
            try:
                (one,) = OverridesParser.create().parse_overrides([word])
            except HydraException as error:
                raise SettingsError(f"{rule}, got '{word}'") from error
            good = bool(one.key_or_group) and not one.is_sweep_override()
            require(good, rule, f"'{word}'")
            own = one.key_or_group in _OWN or one.key_or_group.startswith("hydra.")
            rest = f"pretraining.overrides must not hold {', '.join(_OWN)} or hydra.*"
            require(not own, f"{rest}, which are the exploration's", f"'{word}'")
            read[one.key_or_group] = one.value()
        return read


@dataclass
class ReportConfig(Settings):
    """How often a run says what it does."""

    group = "report"
    every: int = at_least(1)
    pictures_every_s: float = above(0)
    save_every_s: float = above(0)
    best_of: int = at_least(1)


@dataclass
class EvaluateConfig(Settings):
    """The episodes that a run is judged by at its end."""

    group = "evaluate"
    episodes: int = at_least(1, most=_MOST_EPISODES)
    random_episodes: int = at_least(1, most=_MOST_EPISODES)
    random_seed: int = a_seed()
    random_folder: str = MISSING


@dataclass
class ExploreConfig(Settings):
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
    ray: RayConfig = MISSING
    online: OnlineConfig = MISSING
    locomotion: LocomotionConfig = MISSING
    map: MapConfig = MISSING
    pretraining: PretrainingConfig = MISSING
    report: ReportConfig = MISSING
    evaluate: EvaluateConfig = MISSING
    pretrained: str | None = MISSING
    init_policy: str | None = MISSING
    seed: int = a_seed()
    device: str = MISSING
    threads: int | None = at_least(1, most=MOST_THREADS)
    resume: str | None = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        self.loss.check(self.collect.envs)
        batch, decisions = self.collect.envs * self.loss.rollout, self.collect.decisions
        rule = "collect.decisions must be at least collect.envs * loss.rollout"
        require(batch <= decisions, f"{rule} = {batch}, one batch", decisions)
        world, k = self.world, self.locomotion.k
        length, episode = f"{world.group}.episode_length", world.episode_length
        rule = f"locomotion.k must be less than {length} = {episode} decisions"
        require(k < episode, rule, k)
        rule, after = "map.after must be less than collect.decisions", self.map.after
        require(not self.map.grow or after < decisions, f"{rule} = {decisions}", after)
        rooms = {length: episode}
        if self.online.learn:
            # An episode may end in the middle of what there is.
            name = "online.ahead / (2 * collect.envs)"
            rooms[name] = self.online.ahead // (2 * self.collect.envs)
        self.pairs.check_room(rooms, self.pairs.m)

    @property
    def collect_device(self) -> str:
        """Where the networks of collecting processes are, which may be ``auto``."""
        # Ray hides the GPUs of its machines from processes that ask for none.
        usual = "cpu" if self.collect.backend == "ray" else self.device
        return self.collect.device or usual

    def maps_by_poses(self, *, effects_known: bool) -> bool:
        """Whether the map is made again by poses, which needs actions' effects."""
        wanted = self.map.grow and self.map.poses and not self.online.learn
        return wanted and effects_known

    def trains_head(self, *, by_poses: bool) -> bool:
        """Whether the L-network's head is trained after exploring."""
        learn = self.locomotion.learn
        return not self.online.learn and (not by_poses if learn is None else learn)

    def resolved(self, model: ModelConfig | None) -> "ExploreConfig":
        """These settings with ``policy.input`` set and, if any, the networks' model.

        Raises:
            SettingsError: if the policy should see embeddings that nobody makes.
        """
        automatic = "pixels" if model is None else "embedding"
        view = automatic if self.policy.input == "auto" else self.policy.input
        rule = "policy.input must be pixels in a run without networks"
        rule += f" (reward={self.reward.name} and no pretrained)"
        require(view == "pixels" or model is not None, rule, view)
        policy = replace(self.policy, input=view)
        return replace(self, model=model or self.model, policy=policy)
