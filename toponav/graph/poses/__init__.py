"""Where a map's views were taken, found from the agent's own actions and views."""

from toponav.graph.poses.cover import (
    MoveRules as MoveRules,
    choose_waypoints as choose_waypoints,
    count_moves as count_moves,
    drop_unjoined as drop_unjoined,
    nearest_waypoints as nearest_waypoints,
    trusted_moves as trusted_moves,
)
from toponav.graph.poses.frames import (
    decisions_apart as decisions_apart,
    fastest_turn as fastest_turn,
    moved as moved,
)
from toponav.graph.poses.pose_graph import (
    PoseRules as PoseRules,
    Poses as Poses,
    estimate_poses as estimate_poses,
)
from toponav.graph.poses.support import (
    SupportRules as SupportRules,
    find_support as find_support,
)
from toponav.graph.poses.walked_ground import (
    BEARINGS as BEARINGS,
    DISTANCES as DISTANCES,
    WalkedGround as WalkedGround,
    spots as spots,
)
