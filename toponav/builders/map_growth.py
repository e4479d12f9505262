"""`MapGrowth`: the map of an exploration, grown while it explores."""

import copy
import io
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from tqdm import tqdm

from toponav.builders.episode_log import Row
from toponav.builders.maps import make_map
from toponav.builders.mazes import make_layout
from toponav.builders.networks import Networks
from toponav.builders.novelty import for_use, make_novelty
from toponav.builders.run_files import write_history
from toponav.builders.run_map import MAP_FILE, POSES_FILE
from toponav.config import ExploreConfig
from toponav.evaluation import (
    MazeMetric,
    WaypointPoses,
    covered_cells,
    draw_plan,
    draw_topological_map,
    edge_lengths,
    map_quality,
)
from toponav.graph import save_map, sparsify
from toponav.keys import ENV_ID

#: Edges longer than this on foot are false, in cells.
_FAR_CELLS = 3.0


class MapGrowth:
    """A topological map, and the truth by which it is judged.

    The map gets its own copy of the TC-network: the one that learns on is ahead of the
    version with which the explorers embed.

    Args:
        config: settings of the run.
        networks: with their thresholds.
        pretraining_decisions: that the networks had learned from before, for the log;
            NaN if not known.
    """

    def __init__(
        self,
        config: ExploreConfig,
        networks: Networks,
        *,
        pretraining_decisions: float = math.nan,
    ) -> None:
        self.config = config
        self.networks = networks
        self.pretraining_decisions = pretraining_decisions
        self.tc = for_use(
            copy.deepcopy(make_novelty(networks, config.reward)), config.model
        ).tc.eval()
        self.map = make_map(config.map, self.tc, networks.thresholds)
        self.poses = WaypointPoses()
        self.rows: list[Row] = []
        #: Decisions of the run until the map covered every cell, NaN until then.
        self.decisions_to_cover = math.nan
        mask = torch.as_tensor(make_layout(config.maze).open_mask)
        self._metric = MazeMetric(mask)
        self._draw_plan = partial(draw_plan, open_mask=mask)

    def add(self, batch: TensorDictBase, decisions: int) -> int:
        """Feed a batch ``[E, T]``.

        Args:
            batch: what a collector handed over.
            decisions: of the run, this batch included.

        Returns:
            The number of new waypoints.
        """
        if decisions <= self.config.map.after:
            return 0
        envs = self.config.map.envs
        if envs is not None:
            batch = batch[batch.get(ENV_ID)[:, 0, 0] < envs]
            if not len(batch):
                return 0
        self.poses.remember(batch)
        born = self.map.extend(batch)
        self.poses.note(self.map.origins)
        if born and math.isnan(self.decisions_to_cover) and self._covers_all():
            self.decisions_to_cover = float(decisions)
        return born

    def _covers_all(self) -> bool:
        return bool(covered_cells(self._metric, self.poses.values).all())

    def follow(self, version: int) -> None:
        """Take over the networks' weights as they are and embed the map anew.

        Args:
            version: under which they were published.
        """
        self.tc.load_state_dict(self.networks.tc.state_dict())
        self.map.refresh(version)

    def finish(self, folder: Path, decisions: int) -> None:
        """Embed and judge by the last networks, and sparsify if the settings want it.

        Args:
            folder: the run folder; what is there is written anew if it changed.
            decisions: of the run.
        """
        learned, tolerance = self.config.online.learn, self.config.map.sparsify
        if learned:
            self.follow(self.map.network_version + 1)
        if tolerance is not None:
            before = self.map.num_waypoints, len(self.map.edges)
            self.poses.merge(sparsify(self.map, tolerance=tolerance))
            tqdm.write(
                f"map: {before[0]:,} waypoints and {before[1]:,} edges made "
                f"{self.map.num_waypoints:,} and {len(self.map.edges):,}"
            )
        if learned or tolerance is not None:
            self.write(folder, decisions)

    def write(self, folder: Path, decisions: int) -> Row:
        """Write the map, its truth, a row of ``map.csv`` and ``topology.png``.

        Args:
            folder: the run folder.
            decisions: of the run.

        Returns:
            The row.
        """
        grown, poses = self.map, self.poses.values
        quality = map_quality(
            self._metric,
            poses,
            grown.edges,
            grown.edge_cost.amin(1),
            far_cells=_FAR_CELLS,
        )
        row: Row = {
            "decisions": decisions,
            "networks_version": grown.network_version,
            **vars(quality),
            "decisions_to_cover": self.decisions_to_cover,
            "interaction_to_encode": self.decisions_to_cover
            + self.pretraining_decisions,
        }
        self.rows.append(row)
        write_history(folder / "map.csv", self.rows)
        save_map(
            grown.state_dict(),
            folder / MAP_FILE,
            about={"maze": self.config.maze.name},
        )
        _write_array(folder / POSES_FILE, poses)
        self._draw(folder / "topology.png", row)
        return row

    def _draw(self, path: Path, row: Row) -> None:
        grown, poses = self.map, self.poses.values
        far = _FAR_CELLS * self._metric.cell_size
        figure = draw_topological_map(
            poses,
            grown.edges,
            grown.edge_cost.amin(1),
            edge_lengths(self._metric, poses, grown.edges) > far,
            draw=self._draw_plan,
            title=f"{self.config.maze.name} after {row['decisions']:,} decisions: "
            f"{row['coverage']:.0%} of the cells, {row['components']} part"
            f"{'s' if row['components'] != 1 else ''}, {row['false_edges']:.1%} of the "
            "edges false",
        )
        figure.savefig(path, dpi=110)

    def state_dict(self) -> dict[str, object]:
        """What another one needs to go on; unfinished episodes are not in it."""
        return {
            "map": self.map.state_dict(),
            "poses": self.poses.values,
            "rows": self.rows,
            "decisions_to_cover": self.decisions_to_cover,
            "pretraining_decisions": self.pretraining_decisions,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on where `state_dict` was taken, with the networks as they are now."""
        self.map.load_state_dict(state["map"])
        self.poses = WaypointPoses(state["poses"])
        self.rows = list(state["rows"])
        self.decisions_to_cover = state["decisions_to_cover"]
        self.pretraining_decisions = state["pretraining_decisions"]
        if self.config.online.learn:
            self.follow(self.map.network_version)


class NoMap:
    """What stands for `MapGrowth` in a run without a map; it does nothing."""

    def add(self, batch: TensorDictBase, decisions: int) -> int:
        """Look away; no waypoint is new."""
        return 0

    def follow(self, version: int) -> None:
        """Embed nothing."""

    def finish(self, folder: Path, decisions: int) -> None:
        """Change nothing."""

    def write(self, folder: Path, decisions: int) -> None:
        """Write nothing."""

    def state_dict(self) -> None:
        """Nothing."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Forget the map of a run that had one."""


def make_map_growth(
    config: ExploreConfig, networks: Networks, *, pretraining_decisions: float
) -> MapGrowth | NoMap:
    """`MapGrowth` if the settings want a map.

    Args:
        config: settings of the run.
        networks: with their thresholds.
        pretraining_decisions: see `MapGrowth`.

    Raises:
        SettingsError: if a threshold was not calibrated, or does not fit the other.
    """
    if not config.map.grow:
        return NoMap()
    return MapGrowth(config, networks, pretraining_decisions=pretraining_decisions)


def _write_array(path: Path, values: Tensor) -> None:
    """Write a NumPy file, whole or not at all."""
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(values), allow_pickle=False)
    fresh = path.with_name(f".{path.name}.new")
    fresh.write_bytes(buffer.getvalue())
    fresh.replace(path)
