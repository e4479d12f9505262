"""From a map and a picture of the goal to actions."""

from toponav.graph.navigation.localiser import Localiser as Localiser, Map as Map
from toponav.graph.navigation.navigator import (
    Locomotion as Locomotion,
    Navigator as Navigator,
)
from toponav.graph.navigation.plans import Plan as Plan, Planner as Planner
