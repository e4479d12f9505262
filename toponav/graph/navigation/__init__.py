"""From a map and a picture of the goal to actions."""

from toponav.graph.navigation.edge_trials import EdgeTrials as EdgeTrials
from toponav.graph.navigation.localiser import Localiser as Localiser, Map as Map
from toponav.graph.navigation.navigator import (
    Locomotion as Locomotion,
    Navigator as Navigator,
)
from toponav.graph.navigation.path_following import (
    aim_along as aim_along,
    steer as steer,
    to_the_middle as to_the_middle,
    walking_costs as walking_costs,
)
from toponav.graph.navigation.planner import Plan as Plan, Planner as Planner
from toponav.graph.navigation.pose_belief import (
    BeliefRules as BeliefRules,
    PoseBelief as PoseBelief,
)
from toponav.graph.navigation.pose_navigator import (
    PoseMap as PoseMap,
    PoseNavigator as PoseNavigator,
)
from toponav.graph.navigation.practising_navigator import (
    PractisingNavigator as PractisingNavigator,
)
from toponav.graph.navigation.steering_senses import SteeringSenses as SteeringSenses
