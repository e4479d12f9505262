"""The topological map: waypoints, edges, and the file they are kept in."""

from toponav.graph.rules import EdgeRule, ExtendBy, Rules
from toponav.graph.topological_map import TopologicalMap
from toponav.graph.waypoint_graph import WaypointGraph
from toponav.graph.waypoints import Compare, Embed, Waypoints

__all__ = [
    "Compare",
    "EdgeRule",
    "Embed",
    "ExtendBy",
    "Rules",
    "TopologicalMap",
    "WaypointGraph",
    "Waypoints",
]
