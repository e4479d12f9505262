"""`MapGrowth`: the map of an exploration, built while it explores."""

import copy
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from tqdm import tqdm

from toponav import keys
from toponav.builders import (
    NETWORKS,
    Consumer,
    MapNetworks,
    Networks,
    Novelty,
    World,
    action_effects,
    for_inference,
    make_map,
    map_thresholds,
    pretraining_decisions,
)
from toponav.config import ExploreConfig
from toponav.graph import (
    PoseRules,
    TopologicalMap,
    ViewFile,
    consolidate,
    sparsify,
)
from toponav.graph.poses import fastest_turn
from toponav.metrics import waypoint_shares
from toponav.training.episode_log import Row
from toponav.training.ground_training import GroundRules, train_ground
from toponav.training.map_truth import MapTruth, Snapshot
from toponav.training.map_writer import MapWriter
from toponav.training.place_training import (
    OffsetRules,
    PlaceRules,
    train_offsets,
    train_places,
)

#: The file in a run folder that holds the views of the map's waypoints.
VIEWS_FILE = "map_views.bin"
#: Share of the time of finishing that is over when the poses are found, places are
#: learned, then offsets and the ground, on two cores; the rest is writing.
_POSES, _PLACES, _OFFSETS, _GROUND = 0.61, 0.79, 0.91, 0.95


class MapGrowth(Consumer):
    """A topological map, judged by the ground truth where there is any.

    The map gets its own copy of the TC-network: the one that continues training is
    ahead of the version with which the explorers embed. Views are kept in a file in
    ``folder``, without one in memory.
    """

    # The map is in the state, too.
    saved = ("walks", "truth", "rows", "decisions", "growth", "pretraining_decisions")
    finishes_beside = True

    def __init__(
        self,
        settings: ExploreConfig,
        world: World,
        networks: Networks,
        folder: Path | None = None,
    ) -> None:
        self.config = settings.map
        self.trains_online = settings.online.learn
        #: What actions do in free space, where poses are to be found by it.
        effects = action_effects(world.spec)
        by_poses = settings.maps_by_poses(effects_known=effects is not None)
        self.effects = effects if by_poses else None
        self.seed = settings.seed
        self.networks = networks
        #: That the networks had learned from before, for the log; NaN if not known.
        self.pretraining_decisions = pretraining_decisions(settings)
        novelty = for_inference(Novelty(copy.deepcopy(networks.tc)), settings.model)
        self.tc = novelty.tc.eval()
        self.map: TopologicalMap = make_map(
            self.config,
            self.tc,
            networks.thresholds,
            world=world.spec,
            views=None if folder is None else ViewFile(folder / VIEWS_FILE),
            keep_walks=self.effects is not None,
        )
        self.walks = self.map.walks
        self.truth = MapTruth(world) if world.layout is not None else None
        self.writer = MapWriter(world.name, self.truth)
        self.decisions = 0
        #: Views that the map was given, those of ``map.envs`` mazes, and its waypoints,
        #: after each batch.
        self.growth = [(0, 0)]
        # What views say on the last map.
        self.map_networks: MapNetworks | None = None
        self.rows: list[Row] = []
        places = () if self.truth is None else (keys.POSITION, keys.HEADING)
        # A goal's reward says that the agent was put elsewhere.
        later = ("next", keys.DONE), ("next", keys.REWARD), keys.IS_INIT
        turns = self.config.turn_tolerance is not None or self.effects is not None
        done = (keys.ACTION,) if turns else ()
        self.in_keys = [keys.EMBEDDING, keys.NETWORK_PIXELS, *done, *places, *later]

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Feed a batch ``[E, T]``."""
        self.decisions += batch.numel()
        if self.decisions <= self.config.after:
            return {}
        if self.config.envs is not None:
            batch = batch[batch.get(keys.ENV_ID)[:, 0, 0] < self.config.envs]
            if not len(batch):
                return {}
        if self.truth is not None:
            self.truth.poses.remember(batch)
        # A process that died took along what was left of its episodes.
        begins = batch.get(keys.IS_INIT)[:, 0, 0]
        self.map.end_episodes(batch.get(keys.ENV_ID)[begins, 0, 0].tolist())
        new_waypoints = self.map.extend(batch)
        views = self.growth[-1][0] + batch.numel()
        self.growth.append((views, len(self.map.waypoints)))
        if self.truth is not None and new_waypoints:
            self.truth.place(self.map.waypoints.origins, self.decisions)
        return {}

    def refresh(self, versions: Mapping[str, int]) -> None:
        """Take over the networks as published, thresholds too; embed the map again."""
        if NETWORKS in versions:
            self._embed(versions[NETWORKS])

    def _embed(self, version: int) -> None:
        self.tc.load_state_dict(self.networks.tc.state_dict())
        self.map.set_thresholds(*map_thresholds(self.config, self.networks.thresholds))
        self.map.refresh(version)

    def finish(
        self, folder: Path, progress: Callable[[float], object] = lambda _: None
    ) -> None:
        """Embed by the last networks, and make the map smaller as the settings say."""
        tolerance = self.config.sparsify
        self.writer.wait()
        before = self.map.num_waypoints, len(self.map.edges)
        if self.trains_online:
            self._embed(self.map.network_version + 1)
        views = None
        if self.effects is not None:
            views = self.consolidate(_part_of(progress, 0, _POSES))
        if tolerance is not None:
            numbers = sparsify(self.map, tolerance=tolerance)
            if self.truth is not None:
                self.truth.poses.merge(numbers)
        if views is not None:
            self.learn_places(*views, progress)
        now = self.map.num_waypoints, len(self.map.edges)
        if now != before:
            tqdm.write(
                f"map: {before[0]:,} waypoints and {before[1]:,} edges became "
                f"{now[0]:,} and {now[1]:,}"
            )
        is_new = self.trains_online or views is not None or now != before
        if is_new or self.writer.is_behind:
            self.write(folder)
        self.writer.wait()

    def consolidate(
        self, progress: Callable[[float], object] = lambda _: None
    ) -> tuple[Tensor, Tensor] | None:
        """Make the map again of few waypoints, by the poses of all its views.

        Returns embeddings ``[V, D]`` and poses ``[V, 3]`` of these, or ``None`` if they
        do not fit together.
        """
        assert self.effects is not None
        found = consolidate(
            self.map,
            self.effects,
            PoseRules(above=self.map.rules.tc_threshold, seed=self.seed),
            within=self.config.poses_within,
            above=self.config.poses_above,
            progress=progress,
        )
        if found.embeddings is None or found.poses is None:
            tqdm.write(
                "map: as it grew, since too few views fit together by their poses "
                "(recipes/navigate.py walks over it with navigator=topological)"
            )
            return None
        # Of the waypoints after each batch, so many stayed.
        views, before = zip(*self.growth, strict=True)
        after = torch.searchsorted(found.kept, torch.tensor(before)).tolist()
        self.growth = list(zip(views, after, strict=True))
        if self.truth is not None:
            self.truth.poses.keep(found.kept)
        return found.embeddings, found.poses

    def learn_places(
        self, embeddings: Tensor, poses: Tensor, progress: Callable[[float], object]
    ) -> None:
        """Train what says where a view was taken, and where its ground is free."""
        assert self.effects is not None
        turn = fastest_turn(self.effects)
        known = embeddings, poses, self.map.waypoints.poses, turn
        self.map_networks = MapNetworks(
            train_places(
                *known, PlaceRules(seed=self.seed), _part_of(progress, _POSES, _PLACES)
            ),
            train_offsets(
                *known,
                OffsetRules(seed=self.seed),
                _part_of(progress, _PLACES, _OFFSETS),
            ),
            train_ground(
                embeddings,
                poses,
                GroundRules(seed=self.seed),
                _part_of(progress, _OFFSETS, _GROUND),
            ),
        )

    def write(self, folder: Path) -> None:
        """Write the map, its poses, a row of ``map.csv`` and ``topology.png``.

        A thread does it; while it is at the last map, this one is left to the next
        time, or to `finish`.
        """
        self.writer.write(folder, self.snapshot, self.rows)

    def snapshot(self) -> Snapshot:
        """The map as it is now, which does not change while it grows."""
        version = self.map.network_version
        return Snapshot(
            {
                "decisions": self.decisions,
                "networks_version": version,
                **waypoint_shares(self.growth),
            },
            self.map.state_dict(views=False),
            self.map.waypoints.views.pictures(),
            self.map.edge_cost.amin(1),
            torch.empty(0) if self.truth is None else self.truth.poses.values,
            math.nan if self.truth is None else self.truth.decisions_to_cover,
            self.pretraining_decisions,
            self.map_networks,
        )

    def state_dict(self) -> dict[str, Any]:
        """As a consumer's, and the map's; of networks that change without embeddings.

        Those are made again of the views, each of which is written once.
        """
        found = self.map.state_dict(embeddings=not self.trains_online)
        return super().state_dict() | {"map": found}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        super().load_state_dict(state)
        self.map.load_state_dict(state["map"])
        # No checkpoint says whether the files hold this map.
        self.writer.is_behind = True
        if self.trains_online:
            self._embed(self.map.network_version)

    def running_episodes(self) -> dict[str, Any]:
        poses = {} if self.truth is None else self.truth.poses.last
        return {"map": self.map.running_episodes(), "poses": poses}

    def resume_episodes(self, state: Mapping[str, Any]) -> None:
        self.map.resume_episodes(state["map"])
        if self.truth is not None:
            self.truth.poses.last = state["poses"]


def _part_of(
    progress: Callable[[float], object], start: float, end: float
) -> Callable[[float], object]:
    """Progress of what takes from one share of the whole to another."""
    return lambda share: progress(start + (end - start) * share)
