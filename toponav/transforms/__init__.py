"""TorchRL transforms of the surroundings, each usable in any TorchRL project."""

from toponav.transforms.area_downsample import AreaDownsample
from toponav.transforms.count_reward import CountReward
from toponav.transforms.coverage import Coverage
from toponav.transforms.goal_views import GoalViews
from toponav.transforms.intrinsic_reward import IntrinsicReward
from toponav.transforms.noisy_tv import NOISE_LAWS, NoiseLaw, NoisyTV
from toponav.transforms.novelty import (
    aggregate_similarity,
    combine_rewards,
    count_reward,
    temporal_distance_reward,
)
from toponav.transforms.policy_pixels import PolicyPixels
from toponav.transforms.previous_action import PreviousAction
from toponav.transforms.previous_reward import PreviousReward
from toponav.transforms.temporal_distance_reward import TemporalDistanceReward
from toponav.transforms.waypoint_memory import WaypointMemory
from toponav.transforms.waypoint_truth import WaypointTruth

__all__ = [
    "NOISE_LAWS",
    "AreaDownsample",
    "CountReward",
    "Coverage",
    "GoalViews",
    "IntrinsicReward",
    "NoiseLaw",
    "NoisyTV",
    "PolicyPixels",
    "PreviousAction",
    "PreviousReward",
    "TemporalDistanceReward",
    "WaypointMemory",
    "WaypointTruth",
    "aggregate_similarity",
    "combine_rewards",
    "count_reward",
    "temporal_distance_reward",
]
