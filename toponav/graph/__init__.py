"""The topological map, the file it is kept in, and the policy that walks over it."""

from toponav.graph.calibration import (
    MAP_SHARE as MAP_SHARE,
    REWARD_SHARE as REWARD_SHARE,
    Calibration as Calibration,
    WalkWaypoints as WalkWaypoints,
    calibrate_map as calibrate_map,
    calibrate_reach as calibrate_reach,
    calibrate_share as calibrate_share,
    share_curve as share_curve,
)
from toponav.graph.consolidation import (
    Consolidation as Consolidation,
    consolidate as consolidate,
)
from toponav.graph.map_file import (
    MapFileError as MapFileError,
    load_map as load_map,
    save_map as save_map,
)
from toponav.graph.navigation import (
    BeliefRules as BeliefRules,
    EdgeTrials as EdgeTrials,
    Localiser as Localiser,
    Locomotion as Locomotion,
    Map as Map,
    Navigator as Navigator,
    Plan as Plan,
    Planner as Planner,
    PoseBelief as PoseBelief,
    PoseMap as PoseMap,
    PoseNavigator as PoseNavigator,
    PractisingNavigator as PractisingNavigator,
    SteeringSenses as SteeringSenses,
    to_the_middle as to_the_middle,
    walking_costs as walking_costs,
)
from toponav.graph.pieces import MapKeys as MapKeys
from toponav.graph.poses import (
    MoveRules as MoveRules,
    PoseRules as PoseRules,
    SupportRules as SupportRules,
)
from toponav.graph.rules import MapRules as MapRules, NavigatorRules as NavigatorRules
from toponav.graph.sparsify import sparsify as sparsify
from toponav.graph.topological_map import TopologicalMap as TopologicalMap
from toponav.graph.trajectories import Trajectories as Trajectories
from toponav.graph.views import (
    ViewFile as ViewFile,
    Views as Views,
    decode_view as decode_view,
)
from toponav.graph.waypoint_graph import WaypointGraph as WaypointGraph
