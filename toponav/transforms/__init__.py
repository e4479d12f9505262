"""TorchRL transforms of environments, each usable in any TorchRL project."""

from toponav.transforms.agent_inputs import (
    GoalViews as GoalViews,
    PreviousAction as PreviousAction,
    PreviousReward as PreviousReward,
)
from toponav.transforms.embed_views import EmbedViews as EmbedViews
from toponav.transforms.loop_closure import LoopClosure as LoopClosure
from toponav.transforms.noisy_tv import NoisyTV as NoisyTV
from toponav.transforms.novelty_rewards import (
    CountReward as CountReward,
    IntrinsicReward as IntrinsicReward,
    RandomReward as RandomReward,
    TemporalDistanceReward as TemporalDistanceReward,
    count_reward as count_reward,
    temporal_distance_reward as temporal_distance_reward,
)
from toponav.transforms.places import PlacesVisited as PlacesVisited
from toponav.transforms.privileged import (
    Coverage as Coverage,
    WaypointTruth as WaypointTruth,
)
from toponav.transforms.ready_made import (
    make_novelty_reward as make_novelty_reward,
    make_policy_inputs as make_policy_inputs,
)
from toponav.transforms.smaller_views import (
    AreaDownsample as AreaDownsample,
    PolicyPixels as PolicyPixels,
)
from toponav.transforms.specs import SeesLastViews as SeesLastViews
from toponav.transforms.waypoint_memory import WaypointMemory as WaypointMemory
