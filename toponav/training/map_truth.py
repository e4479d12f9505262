"""`MapTruth`: judges a map by the ground truth, at one moment of its growth."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from torch import Tensor

from toponav.builders import MapNetworks, World
from toponav.graph import decode_view, walking_costs
from toponav.ground_truth import GroundTruthDistances, WaypointPoses, require_motion
from toponav.metrics import FALSE_EDGE_CELLS, covered_cells, edge_lengths, map_quality
from toponav.plotting import FloorPlan, draw_topological_map
from toponav.training.episode_log import Row


@dataclass(frozen=True)
class Snapshot:
    """A map at one moment, to be written while it grows."""

    row: Row
    state: dict[str, Any]  # without views
    views: Sequence[Tensor | bytes]
    cost: Tensor  # of the edges, in the cheaper direction
    poses: Tensor
    decisions_to_cover: float
    pretraining_decisions: float
    networks: MapNetworks | None = None  # what views say on it, if it has poses

    def find_views(self, numbers: Collection[int]) -> dict[int, np.ndarray]:
        """Views of some waypoints by their numbers, where there are any."""
        some = [number for number in numbers if number < len(self.views)]
        found = {number: self.views[number] for number in some}
        return {
            number: (decode_view(one) if isinstance(one, bytes) else one).numpy()
            for number, one in found.items()
        }


class MapTruth:
    """Judges a map of a maze by the ground truth; no agent and no map reads it."""

    def __init__(self, world: World) -> None:
        mask = world.floor
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

    def lengths(self, now: Snapshot) -> Tensor:
        """How far the ends of each edge are apart on foot, map units ``[E]``."""
        return edge_lengths(self._metric, now.poses, now.state["edges"])

    def measure(self, now: Snapshot, lengths: Tensor) -> Row:
        """Columns of ``map.csv``, see `MapQuality`."""
        edges, cost = now.state["edges"], now.cost
        walked, positions = cost <= 1, now.state["positions"]
        if not positions.isnan().any():
            # As a navigator that knows poses plans.
            cost = walking_costs(positions, edges, now.state["traversals"])
        given = self._metric, now.poses, edges, cost
        quality = map_quality(*given, lengths=lengths, walked=walked)
        return {
            "cells": int(self._metric.open_mask.sum()),
            **vars(quality),
            "decisions_to_cover": now.decisions_to_cover,
            "interaction_to_encode": now.decisions_to_cover + now.pretraining_decisions,
        }

    def draw(self, now: Snapshot, lengths: Tensor, title: str, parts: str) -> Figure:
        """The map over the plan; ``parts`` are as many as it seems to have."""
        title += f"{now.row['coverage']:.0%} of the cells, {parts} "
        title += f"({now.row['true_components']} without the false edges, "
        title += f"{now.row['false_edges']:.1%})"
        spurious = lengths > FALSE_EDGE_CELLS * self._metric.cell_size
        given = now.poses, now.state["edges"], now.cost, spurious
        return draw_topological_map(*given, plan=self._plan, title=title)

    def state_dict(self) -> dict[str, Any]:
        cover = self.decisions_to_cover
        return {"poses": self.poses.values, "decisions_to_cover": cover}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        self.poses = WaypointPoses(state["poses"])
        self.decisions_to_cover = state["decisions_to_cover"]
