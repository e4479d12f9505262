"""Novelty by temporal distance: the paper's reward."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tensordict import NestedKey
from torch import Tensor
from torchrl.envs.transforms import Transform

from toponav import keys
from toponav.builders import (
    Networks,
    Novelty,
    RewardMethod,
    World,
    make_empty_novelty,
    threshold_of,
)
from toponav.config import (
    ExploreConfig,
    RewardConfig,
    at_least,
    between,
    one_of,
    threshold_or,
)
from toponav.transforms import (
    CountReward,
    IntrinsicReward,
    TemporalDistanceReward,
    WaypointMemory,
    WaypointTruth,
)

#: A new waypoint this near to an older one, in cells, is spurious.
_SPURIOUS_CELLS = 0.75
#: Words that stand for a calibrated threshold, and its name among the networks'.
_CALIBRATED = {"auto": "reward_threshold", "tc": "tc_threshold"}


@dataclass
class NoveltyConfig(RewardConfig):
    """Settings of ``reward=novelty``."""

    alpha: float = between(0, 1)
    beta: float | None = at_least(0)
    threshold: str = threshold_or(*_CALIBRATED)
    floor: float = between(0.001, 1)
    combine: str = one_of("exclusive", "sum")
    persistence: int = at_least(1)
    min_gap: int = at_least(1)
    count_on: str = one_of("every", "entry")
    capacity: int | None = at_least(1)

    @property
    def weights(self) -> tuple[float, float]:
        """Alpha and beta; a beta that is not given is 1 - alpha."""
        return self.alpha, 1 - self.alpha if self.beta is None else self.beta


class NoveltyMethod(RewardMethod):
    """Known places pay by their visits (eq. 6), new ones by temporal distance (eq. 7).

    `SettingsError` if the threshold should be a calibrated one and there is none.
    """

    schema = NoveltyConfig
    config: NoveltyConfig
    novelty: Novelty
    needs_networks = True
    embeds = True
    reward_key = keys.INTRINSIC_REWARD

    def __init__(
        self, settings: ExploreConfig, world: World, networks: Networks | None
    ) -> None:
        super().__init__(settings, world, networks)
        # The first view of an episode comes before its first decision.
        self.most_waypoints = self.config.capacity or world.episode_length + 1
        self.motion = world.spec.motion
        # Waypoints of running episodes are embedded again when the networks change.
        self.keep_images = settings.online.learn
        if networks is None:
            self.novelty = make_empty_novelty(settings.model, world.spec)
        else:
            self.novelty = Novelty(networks.tc)
            self.recalibrate(networks.thresholds)

    def recalibrate(self, thresholds: Mapping[str, float]) -> None:
        word = self.config.threshold
        threshold = threshold_of("reward.threshold", word, _CALIBRATED, thresholds)
        self.novelty.threshold.fill_(threshold)

    def make_transforms(self, *, num_envs: int, seed: int) -> list[Transform]:
        config, (alpha, beta) = self.config, self.config.weights
        combine: Any = config.combine
        transforms: list[Transform] = [
            self.make_memory(),
            CountReward(alpha, combine=combine),
            TemporalDistanceReward(beta, floor=config.floor, combine=combine),
            IntrinsicReward(),
        ]
        if self.motion is not None:
            distance = _SPURIOUS_CELLS * self.motion.cell_size
            transforms.append(WaypointTruth(distance=distance))
        return transforms

    def make_memory(self) -> WaypointMemory:
        """The episode's memory of waypoints, with this method's TC-network."""
        config, tc = self.config, self.novelty.tc
        dtype = next(tc.parameters()).dtype

        def compare(embedding: Tensor, prepared: Tensor) -> Tensor:
            return tc.compare_prepared(embedding.to(dtype), prepared.to(dtype))

        def prepare(memory: Tensor) -> Tensor:
            return tc.prepare_memory(memory.to(dtype)).float()

        return WaypointMemory(
            tc.embed,
            compare,
            prepare=prepare,
            in_keys=[keys.NETWORK_PIXELS],
            capacity=self.most_waypoints,
            threshold=float(self.novelty.threshold),
            persistence=config.persistence,
            min_gap=config.min_gap,
            count_on=config.count_on,  # type: ignore[arg-type]
            keep_images=self.keep_images,
        )

    def episode_sums(self) -> dict[str, NestedKey]:
        sums: dict[str, NestedKey] = {
            "intrinsic_return": keys.INTRINSIC_REWARD,
            "count_return": keys.COUNT_REWARD,
            "temporal_distance_return": keys.TEMPORAL_DISTANCE_REWARD,
            "new_waypoints": keys.IS_NEW_WAYPOINT,
        }
        if self.motion is not None:
            sums["spurious_waypoints"] = keys.SPURIOUS_WAYPOINT
        return sums

    def episode_ends(self) -> dict[str, NestedKey]:
        return {"waypoints": keys.NUM_WAYPOINTS}
