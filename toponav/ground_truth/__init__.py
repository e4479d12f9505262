"""The truth about a maze: what evaluation knows and no agent sees."""

from toponav.ground_truth.distances import (
    GroundTruthDistances as GroundTruthDistances,
    PairTruth as PairTruth,
    cell_centres as cell_centres,
    pair_truth as pair_truth,
    pick_goal_views as pick_goal_views,
)
from toponav.ground_truth.routes import (
    UNREACHABLE as UNREACHABLE,
    Routes as Routes,
    Steering as Steering,
    bearing as bearing,
    require_motion as require_motion,
    wrap_degrees as wrap_degrees,
)
from toponav.ground_truth.waypoint_poses import WaypointPoses as WaypointPoses
