"""Coverage: pays for cells entered for the first time, by the ground truth."""

from toponav.builders import Networks, RewardMethod, World
from toponav.config import ExploreConfig, require
from toponav.keys import COVERAGE_REWARD


class CoverageMethod(RewardMethod):
    """An upper bound: the ground truth is the reward, never an observation.

    The key is written by the ``Coverage`` transform, which every environment with
    ground truth has.

    Raises:
        SettingsError: in a world without ground truth.
    """

    selection_metric = "coverage"
    reward_key = COVERAGE_REWARD

    def __init__(
        self, settings: ExploreConfig, world: World, networks: Networks | None
    ) -> None:
        super().__init__(settings, world, networks)
        require(
            world.spec.has_truth,
            "reward=coverage must be used in a world that tells poses",
            world.name,
        )
