"""`consolidate`: a map of few waypoints, by the poses of its views."""

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toponav.graph.poses import (
    MoveRules,
    PoseRules,
    Poses,
    SupportRules,
    choose_waypoints,
    count_moves,
    drop_hanging,
    drop_unjoined,
    estimate_poses,
    fastest_turn,
    find_support,
    nearest_waypoints,
    trusted_moves,
)
from toponav.graph.topological_map import TopologicalMap
from toponav.graph.trajectories import Trajectory
from toponav.parts import require_parts

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]

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
    support_rules: SupportRules | None = None,
    progress: Callable[[float], object] = lambda _: None,
) -> Consolidation:
    """Make a map again of few of its waypoints, and of the moves between them.

    The poses of all views that the map was fed, its ``walks``, are estimated. Those of
    its waypoints, and how far other walks support them (`find_support`), choose which
    of them stay (`choose_waypoints`). Each view belongs to the nearest that it is like,
    and an edge joins two waypoints if a walk went from one to the other. Where no poses
    are found, nothing changes.

    Args:
        topological_map: one with walks; what was in progress is dropped.
        effects: of the actions in free space, float32 ``[A, 3]``: steps ahead and to
            the left (1 for the fastest action) and degrees to the left.
        rules: how the poses are found.
        within: decisions, in free space, up to which a waypoint stands for a view.
        above: similarity that it must have to it as well.
        move_rules: which moves become edges, `MoveRules`'s own by default.
        support_rules: which views say that a waypoint is where it seems to be, by
            default `SupportRules`'s own.
        progress: called with the share that is done of what takes longest, the poses.
    """
    wanted = "waypoints", "walks", "rebuild"
    require_parts(topological_map, "topological_map", "a TopologicalMap", *wanted)
    waypoints, walks = topological_map.waypoints, _known(topological_map)
    unchanged = Consolidation(torch.arange(len(waypoints)))
    steps = sum(len(walk.actions) - 1 for walk in walks)
    if not steps or not len(waypoints):
        return unchanged
    poses = estimate_poses(
        walks, effects, waypoints.compare, waypoints.entries_of, rules, progress
    )
    if poses.known < rules.least_known or poses.fit < _FIT:
        return unchanged
    views = _Views(topological_map, walks, poses, above, fastest_turn(effects))
    kept = views.choose_waypoints(
        within, support_rules or SupportRules(seed=rules.seed)
    )
    if len(kept) < 2:
        return unchanged
    moves = views.count_moves(kept, within + _MARGIN)
    positions, rules_of_moves = views.places[kept, :2], move_rules or MoveRules()
    moves = trusted_moves(moves, positions, rules_of_moves)
    moves = drop_hanging(moves, positions, rules_of_moves)
    joined, moves = drop_unjoined(moves, len(kept))
    numbers = torch.from_numpy(kept[joined])
    chosen_poses = torch.from_numpy(views.places[numbers]).float()
    topological_map.rebuild(numbers, moves, chosen_poses)
    of_views = torch.from_numpy(views.poses).float()
    return Consolidation(numbers, views.embeddings, of_views)


class _Views:
    """All V views of a map's walks, and the candidates for its waypoints among them."""

    def __init__(
        self,
        topological_map: TopologicalMap,
        walks: Sequence[Trajectory],
        poses: Poses,
        above: float,
        turn: float,
    ) -> None:
        self.waypoints = topological_map.waypoints
        self.embeddings = torch.cat([walk.embeddings for walk in walks])
        of_views = torch.cat([poses.position, poses.heading.unsqueeze(1)], 1)
        self.poses = of_views.double().numpy()
        lengths = [len(walk.actions) for walk in walks]
        self.walk_of = np.repeat(np.arange(len(walks)), lengths)
        self.ends = np.cumsum(lengths)[:-1]
        #: View and pose of each candidate; -1 and NaN where they are not known.
        self.rows = _rows_of_waypoints(topological_map, walks)
        self.places = self.poses[self.rows]
        self.places[self.rows < 0] = np.nan
        self.above, self.turn = above, turn

    def choose_waypoints(self, within: float, rules: SupportRules) -> Numbers:
        """Numbers of the candidates that stand for all."""
        walks, candidates = self.walk_of, self.waypoints.embeddings
        support = find_support(
            self.places,
            walks[self.rows],
            self.poses,
            walks,
            lambda one, other: self._alike(self.embeddings, one, other),
            turn=self.turn,
            rules=rules,
        )
        return choose_waypoints(
            self.places,
            lambda one, other: self._alike(candidates, one, other),
            within=within,
            above=self.above,
            turn=self.turn,
            support=support,
            least=rules.least,
            rounding=rules.rounding,
        )

    def count_moves(self, kept: Numbers, within: float) -> Counter[tuple[int, int]]:
        """How often walks went from one of the chosen candidates to another."""
        near = nearest_waypoints(
            self.poses,
            self.places[kept],
            lambda one, other: self._alike(self.embeddings, one, kept[other]),
            within=within,
            above=self.above,
            turn=self.turn,
        )
        return count_moves(np.split(near, self.ends))

    def _alike(self, embeddings: Tensor, rows: Numbers, candidates: Numbers) -> Floats:
        """Similarities of some of the ``embeddings`` to candidates, pair by pair."""
        found = [np.empty(0)]
        for start in range(0, len(rows), _PAIRS):
            some = slice(start, start + _PAIRS)
            entries = self.waypoints.prepared[candidates[some]].unsqueeze(1)
            one = embeddings[rows[some]].float()
            similar = self.waypoints.compare(one, entries)
            found.append(similar.squeeze(1).double().numpy())
        return np.concatenate(found)


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
