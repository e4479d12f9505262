"""`consolidate`: a map of few waypoints, by the poses of its views."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toponav.graph.poses import (
    MoveRules,
    PoseRules,
    choose_waypoints,
    count_moves,
    estimate_poses,
    fastest_turn,
    nearest_waypoints,
    trusted_moves,
)
from toponav.graph.topological_map import TopologicalMap
from toponav.graph.trajectories import Trajectory
from toponav.parts import require_parts

#: Pairs of a view and a waypoint that are compared in one call.
_PAIRS = 4096
#: Share of the pairs of views that look like one place and must fit, for a map to be
#: made again by them.
_FIT = 0.5
#: A view may be a little further from its waypoint than waypoints are from each other.
_MARGIN = 1.0


@dataclass(frozen=True)
class Consolidation:
    """What became of a map."""

    kept: Tensor  # int64 [W']; numbers of the waypoints that stayed
    #: Of the V views of all walks: embeddings ``[V, D]``, float16, and poses ``[V,
    #: 3]``, steps, steps and degrees; both ``None`` where the map stayed as it was.
    embeddings: Tensor | None = None
    poses: Tensor | None = None


@torch.no_grad()
def consolidate(
    topological_map: TopologicalMap,
    effects: Tensor,
    rules: PoseRules,
    *,
    within: float,
    above: float,
    move_rules: MoveRules | None = None,
) -> Consolidation:
    """Make a map again of few of its waypoints, and of the moves between them.

    The poses of all views that the map was fed, its ``walks``, are estimated; those of
    its waypoints choose which of them stay (`choose_waypoints`), each view belongs to
    the nearest that it is like, and an edge joins two waypoints if a walk went from one
    to the other. Where no poses are found, nothing changes.

    Args:
        topological_map: one with walks; what was in progress is dropped.
        effects: of the actions in free space, float32 ``[A, 3]``: steps ahead and to
            the left (1 for the fastest action) and degrees to the left.
        rules: how the poses are found.
        within: decisions, in free space, up to which a waypoint stands for a view.
        above: similarity that it must have to it as well.
        move_rules: which moves become edges, `MoveRules`'s own by default.
    """
    wanted = "waypoints", "walks", "rebuild"
    require_parts(topological_map, "topological_map", "a TopologicalMap", *wanted)
    waypoints, walks = topological_map.waypoints, _known(topological_map)
    unchanged = Consolidation(torch.arange(len(waypoints)))
    if len(walks) == 0 or not len(waypoints):
        return unchanged
    poses = estimate_poses(
        walks, effects, waypoints.compare, waypoints.entries_of, rules
    )
    if poses.known < rules.least_known or poses.fit < _FIT:
        return unchanged
    of_views = torch.cat([poses.position, poses.heading.unsqueeze(1)], 1)
    views = of_views.double().numpy()
    places = views[rows := _rows_of_waypoints(topological_map, walks)]
    places[rows < 0] = np.nan
    turn = fastest_turn(effects)
    limits = {"above": above, "turn": turn}

    def alike(one: Tensor, entries: Tensor) -> NDArray[np.float64]:
        parts = zip(one.split(_PAIRS), entries.split(_PAIRS), strict=True)
        found = [waypoints.compare(some, to.unsqueeze(1)) for some, to in parts]
        return torch.cat(found).squeeze(1).double().numpy()

    kept = choose_waypoints(
        places,
        lambda one, other: alike(waypoints.embeddings[one], waypoints.prepared[other]),
        within=within,
        **limits,
    )
    if len(kept) < 2:
        return unchanged
    embeddings = torch.cat([walk.embeddings for walk in walks])
    chosen = waypoints.prepared[kept]
    near = nearest_waypoints(
        views,
        places[kept],
        lambda one, other: alike(embeddings[one].float(), chosen[other]),
        within=within + _MARGIN,
        **limits,
    )
    ends = np.cumsum([len(walk.actions) for walk in walks])[:-1]
    moves = count_moves(np.split(near, ends))
    moves = trusted_moves(moves, places[kept, :2], move_rules or MoveRules())
    chosen_poses = torch.from_numpy(places[kept]).float()
    topological_map.rebuild(torch.from_numpy(kept), moves, chosen_poses)
    return Consolidation(torch.from_numpy(kept), embeddings, of_views)


def _known(topological_map: TopologicalMap) -> list[Trajectory]:
    walks = topological_map.walks
    return [] if walks is None else [walk for walk in walks.all() if len(walk.actions)]


def _rows_of_waypoints(
    topological_map: TopologicalMap, walks: Sequence[Trajectory]
) -> NDArray[np.int64]:
    """The view of each waypoint among those of all walks, -1 if it is not there.

    Numbers of observations begin again when a run resumes: embeddings must agree, too.
    """
    starts = np.cumsum([0, *(len(walk.actions) for walk in walks)])
    of_env = defaultdict[int, list[tuple[int, Trajectory]]](list)
    for start, walk in zip(starts.tolist(), walks, strict=False):
        of_env[walk.env].append((start, walk))
    found = []
    waypoints = topological_map.waypoints
    embeddings = waypoints.embeddings.half()
    for number, (env, at) in enumerate(waypoints.origins.tolist()):
        row = -1
        for start, walk in of_env[env]:
            if 0 <= at - walk.number < len(walk.actions) and torch.equal(
                walk.embeddings[at - walk.number], embeddings[number]
            ):
                row = start + at - walk.number
        found.append(row)
    return np.array(found, np.int64)
