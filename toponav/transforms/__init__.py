"""TorchRL transforms of environments, each usable in any TorchRL project."""

from toponav.transforms.area_downsample import AreaDownsample as AreaDownsample
from toponav.transforms.coverage import Coverage as Coverage
from toponav.transforms.embed_views import EmbedViews as EmbedViews
from toponav.transforms.goal_views import GoalViews as GoalViews
from toponav.transforms.noisy_tv import NoisyTV as NoisyTV
from toponav.transforms.novelty_rewards import (
    CountReward as CountReward,
    IntrinsicReward as IntrinsicReward,
    RandomReward as RandomReward,
    TemporalDistanceReward as TemporalDistanceReward,
    count_reward as count_reward,
    temporal_distance_reward as temporal_distance_reward,
)
from toponav.transforms.policy_inputs import (
    PolicyPixels as PolicyPixels,
    PreviousAction as PreviousAction,
    PreviousReward as PreviousReward,
)
from toponav.transforms.waypoint_memory import WaypointMemory as WaypointMemory
from toponav.transforms.waypoint_truth import WaypointTruth as WaypointTruth
