"""Coverage: pays for cells entered for the first time, by the ground truth."""

from toponav.builders import Networks, RewardMethod, World
from toponav.config import ExploreConfig, require
from toponav.keys import COVERAGE_REWARD


class CoverageMethod(RewardMethod):
    """An upper bound, not an agent to report: the ground truth is its reward.

    The policy sees no more of it than the previous reward, as with any method.

    The ``Coverage`` transform of every environment with ground truth writes the key; in
    a world without any, this is a `SettingsError`.
    """

    selection_metric = "coverage"
    reward_key = COVERAGE_REWARD

    def __init__(
        self, settings: ExploreConfig, world: World, networks: Networks | None
    ) -> None:
        super().__init__(settings, world, networks)
        rule = "reward=coverage must be used in a world that tells poses"
        require(world.spec.has_truth, rule, world.name)
