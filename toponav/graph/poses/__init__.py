"""Where a map's views were taken, found from the agent's own actions and views."""

from toponav.graph.poses.cover import (
    choose_waypoints as choose_waypoints,
    nearest_waypoints as nearest_waypoints,
)
from toponav.graph.poses.frames import (
    decisions_apart as decisions_apart,
    fastest_turn as fastest_turn,
    moved as moved,
)
from toponav.graph.poses.moves import (
    MoveRules as MoveRules,
    count_moves as count_moves,
    drop_hanging as drop_hanging,
    drop_unjoined as drop_unjoined,
    trusted_moves as trusted_moves,
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
