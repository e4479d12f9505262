"""The topological map: waypoints, edges, and the file they are kept in."""

from toponav.graph.localiser import Localiser, Map
from toponav.graph.map_file import MapFileError, load_map, save_map
from toponav.graph.navigator import Locomotion, Navigator
from toponav.graph.planner import Plan, Planner
from toponav.graph.rules import EdgeRule, ExtendBy, Rules
from toponav.graph.sparsify import sparsify
from toponav.graph.topological_map import TopologicalMap
from toponav.graph.waypoint_graph import WaypointGraph
from toponav.graph.waypoints import Compare, Embed, Waypoints

__all__ = [
    "Compare",
    "EdgeRule",
    "Embed",
    "ExtendBy",
    "Localiser",
    "Locomotion",
    "Map",
    "MapFileError",
    "Navigator",
    "Plan",
    "Planner",
    "Rules",
    "TopologicalMap",
    "WaypointGraph",
    "Waypoints",
    "load_map",
    "save_map",
    "sparsify",
]
