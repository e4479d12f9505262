"""`MapTruth`: where a map's waypoints are, and how good the map is."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from matplotlib.figure import Figure
from torch import Tensor

from toponav.builders import World
from toponav.graph import TopologicalMap
from toponav.ground_truth import GroundTruthDistances, WaypointPoses, require_motion
from toponav.metrics import covered_cells, edge_lengths, map_quality
from toponav.plotting import FloorPlan, draw_topological_map
from toponav.training.episode_log import Row

#: Edges longer than this on foot are false, in cells.
_FAR_CELLS = 3.0


class MapTruth:
    """Judges a map of a maze by the ground truth; no agent and no map reads it."""

    def __init__(self, world: World) -> None:
        assert world.layout is not None
        mask = torch.as_tensor(world.layout.open_mask)
        self.poses = WaypointPoses()
        #: Decisions of the run until the map covered every cell, NaN until then.
        self.decisions_to_cover = math.nan
        cell_size = require_motion(world.spec).cell_size
        self._metric = GroundTruthDistances(mask, cell_size=cell_size)
        self._plan = FloorPlan(mask, cell_size=cell_size)

    def place(self, origins: Tensor, decisions: int) -> None:
        """Find the poses of new waypoints; see `WaypointPoses`."""
        self.poses.extend(origins)
        if not math.isnan(self.decisions_to_cover):
            return
        if bool(covered_cells(self._metric, self.poses.values).all()):
            self.decisions_to_cover = float(decisions)

    def measure(self, topological_map: TopologicalMap, pretrained: float) -> Row:
        """Columns of ``map.csv``, see `MapQuality`; ``pretrained`` decisions count."""
        quality = map_quality(
            self._metric,
            self.poses.values,
            topological_map.edges,
            topological_map.edge_cost.amin(1),
            far_cells=_FAR_CELLS,
        )
        return {
            **vars(quality),
            "decisions_to_cover": self.decisions_to_cover,
            "interaction_to_encode": self.decisions_to_cover + pretrained,
        }

    def draw(self, topological_map: TopologicalMap, title: str) -> Figure:
        """The map over the plan."""
        poses, edges = self.poses.values, topological_map.edges
        far = _FAR_CELLS * self._metric.cell_size
        return draw_topological_map(
            poses,
            edges,
            topological_map.edge_cost.amin(1),
            edge_lengths(self._metric, poses, edges) > far,
            plan=self._plan,
            title=title,
        )

    def state_dict(self) -> dict[str, Any]:
        return {
            "poses": self.poses.values,
            "decisions_to_cover": self.decisions_to_cover,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        self.poses = WaypointPoses(state["poses"])
        self.decisions_to_cover = state["decisions_to_cover"]
