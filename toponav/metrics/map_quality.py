"""How good a topological map is, by ground truth that the map itself never sees."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import rustworkx
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from torch import Tensor

from toponav.ground_truth import GroundTruthDistances, wrap_degrees

# A pair of waypoints is close up to this distance on foot and difference of headings.
_NEAR_CELLS, _NEAR_DEGREES = 1.0, 45.0
# Random waypoints from which pairs and paths start.
_SAMPLES = 100


@dataclass(frozen=True)
class MapQuality:
    """A map in numbers; shares are in [0, 1], NaN where there is nothing to count."""

    waypoints: int
    edges: int
    coverage: float  # share of the open cells in which a waypoint lies
    false_edges: float  # share of the edges whose ends are far apart on foot
    false_walked_edges: float  # the same among the edges that were walked
    # Share of the planned paths between random waypoints that contain a false edge.
    false_paths: float
    # Share of the pairs of waypoints that lie close and look the same way, but that no
    # short path joins.
    missing_edges: float
    components: int  # parts of the map that no path joins
    largest_component: float  # share of the waypoints in it
    true_components: int  # parts without the false edges
    stretch: float  # median length of a planned path over that of the shortest one
    mean_stretch: float  # its mean, in which paths over false edges weigh more


#: Edges longer than this on foot are false, in cells.
FALSE_EDGE_CELLS = 3.0


def map_quality(
    distances: GroundTruthDistances,
    poses: Tensor,
    edges: Tensor,
    edge_cost: Tensor,
    *,
    lengths: Tensor | None = None,
    walked: Tensor | None = None,
    far_cells: float = FALSE_EDGE_CELLS,
    hops: int = 3,
    seed: int = 0,
) -> MapQuality:
    """Judge a map by the poses of its W waypoints.

    Poses ``[W, 3]`` are x and y in map units and heading in degrees. Paths over the
    ``edges``, int64 ``[E, 2]``, are planned by ``edge_cost`` ``[E]``, and short up to
    so many ``hops``. An edge is false if its ends are more than ``far_cells`` apart on
    foot; ``lengths`` ``[E]`` are `edge_lengths`, if known. ``walked``, bool ``[E]``,
    says which edges were, those that cost 1 by default. ``seed`` is of the draw of
    waypoints.

    Examples:
        >>> distances = GroundTruthDistances(torch.ones(1, 6).bool(), cell_size=10)
        >>> poses = torch.tensor([[5.0, 5, 0], [7.5, 5, 0], [15, 5, 0], [55, 5, 0]])
        >>> edges = torch.tensor([[0, 2], [1, 2], [2, 3]])  # the last spans four cells
        >>> quality = map_quality(distances, poses, edges, torch.ones(3))
        >>> quality.coverage, quality.false_edges, quality.missing_edges
        (0.5, 0.3333..., 0.0)
    """
    if poses.ndim != 2 or poses.shape[1] != 3:
        raise ValueError(f"poses must be [W, 3], got {list(poses.shape)}")
    if edges.shape != (len(edge_cost), 2):
        wanted = f"[{len(edge_cost)}, 2] as edge_cost has {len(edge_cost)}"
        raise ValueError(f"edges must be {wanted}, got {list(edges.shape)}")
    graph = rustworkx.PyGraph(multigraph=False)
    graph.add_nodes_from(range(len(poses)))
    graph.add_edges_from([*zip(*edges.T.tolist(), edge_cost.tolist(), strict=True)])
    if lengths is None:
        lengths = edge_lengths(distances, poses, edges)
    far = lengths > far_cells * distances.cell_size
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.randperm(len(poses), generator=generator)[:_SAMPLES]
    goals = _draw_goals(drawn, len(poses), generator)
    shortest = edge_lengths(distances, poses, goals)
    # A detour of a step would weigh too much on a path of two.
    far_enough = shortest >= 2 * distances.cell_size
    ends = dict(zip(map(frozenset, edges.tolist()), lengths.tolist(), strict=True))
    paths = _planned_paths(graph, goals[far_enough], shortest[far_enough], ends)
    stretches, farthest = paths.unbind(1)
    leads_wrong = farthest > far_cells * distances.cell_size
    return MapQuality(
        waypoints=len(poses),
        edges=len(edges),
        coverage=float(covered_cells(distances, poses).float().mean()),
        false_edges=float(far.float().mean()),
        false_walked_edges=float(
            far[edge_cost <= 1 if walked is None else walked].float().mean()
        ),
        false_paths=float(leads_wrong.float().mean()),
        missing_edges=_missing_edges(distances, poses, edges, drawn, hops),
        **map_parts(len(poses), edges),
        true_components=int(map_parts(len(poses), edges[~far])["components"]),
        stretch=float(stretches.median()) if len(stretches) else float("nan"),
        mean_stretch=float(stretches.mean()),
    )


def _adjacency(num_waypoints: int, edges: Tensor) -> csr_array:
    links = (np.ones(len(edges)), tuple(edges.numpy().T))
    return csr_array(links, shape=(num_waypoints, num_waypoints))


def waypoint_shares(growth: Sequence[tuple[int, int]]) -> dict[str, float]:
    """Shares of the first and of the last tenth of the views that became waypoints.

    ``growth`` has views and waypoints so far, from (0, 0) on.

    Reference:
        The paper, eq. 11: in the end, the waypoints represent all observations.

    Examples:
        >>> waypoint_shares([(0, 0), (10, 8), (90, 18), (100, 19)])
        {'first_waypoint_share': 0.8, 'last_waypoint_share': 0.1}
    """
    views, waypoints = np.array(growth, dtype=float).T
    tenth = views[-1] / 10
    if not tenth:
        return dict.fromkeys(("first_waypoint_share", "last_waypoint_share"), math.nan)
    early, late = np.interp([tenth, 9 * tenth], views, waypoints)
    return {
        "first_waypoint_share": float(early / tenth),
        "last_waypoint_share": float((waypoints[-1] - late) / tenth),
    }


def map_parts(num_waypoints: int, edges: Tensor) -> dict[str, Any]:
    """`MapQuality.components` and ``largest_component``, which need no ground truth."""
    joined = _adjacency(num_waypoints, edges)
    num_parts, part = connected_components(joined, directed=False)
    largest = np.bincount(part).max() / num_waypoints if num_parts else np.nan
    return {"components": num_parts, "largest_component": float(largest)}


def covered_cells(distances: GroundTruthDistances, poses: Tensor) -> Tensor:
    """In which open cells of `Routes` one of the poses lies, bool ``[N]``."""
    covered = torch.zeros(len(distances.routes.cells), dtype=torch.bool)
    covered[distances.cell_numbers(poses[:, :2])] = True
    return covered


def edge_lengths(
    distances: GroundTruthDistances, poses: Tensor, edges: Tensor
) -> Tensor:
    """How far the ends of each edge are apart on foot, map units ``[E]``."""
    return distances.geodesic(*poses[edges.T, :2])


def _missing_edges(
    distances: GroundTruthDistances,
    poses: Tensor,
    edges: Tensor,
    drawn: Tensor,
    hops: int,
) -> float:
    limit = _NEAR_CELLS * distances.cell_size
    gap = poses - poses[drawn].unsqueeze(1)
    turned = wrap_degrees(gap[..., 2]).abs() <= _NEAR_DEGREES
    pairs = (turned & (gap[..., :2].norm(dim=-1) <= limit)).nonzero()
    pairs = pairs[drawn[pairs[:, 0]] != pairs[:, 1]]
    ends = torch.stack([drawn[pairs[:, 0]], pairs[:, 1]], 1)
    row, other = pairs[edge_lengths(distances, poses, ends) <= limit].numpy().T
    if not len(row):
        return float("nan")
    start, graph = drawn.numpy(), _adjacency(len(poses), edges)
    away = dijkstra(graph, directed=False, indices=start, unweighted=True, limit=hops)
    return float(np.isinf(away[row, other]).mean())


def _draw_goals(
    drawn: Tensor, num_waypoints: int, generator: torch.Generator
) -> Tensor:
    """Another waypoint for each that was drawn, int64 ``[P, 2]`` with both."""
    if num_waypoints < 2:
        return torch.empty(0, 2, dtype=torch.int64)
    further = [torch.randint(1, num_waypoints, (), generator=generator) for _ in drawn]
    return torch.stack([drawn, (drawn + torch.stack(further)) % num_waypoints], 1)


def _planned_paths(
    graph: rustworkx.PyGraph,
    goals: Tensor,
    shortest: Tensor,
    lengths: Mapping[frozenset[int], float],
) -> Tensor:
    """Stretch and longest edge of those paths that there are, ``[P, 2]``.

    ``shortest`` are the ways on foot ``[P]``, ``lengths`` those of the edges.
    """
    found: list[tuple[float, float]] = []
    for (one, goal), on_foot in zip(goals.tolist(), shortest.tolist(), strict=True):
        paths = rustworkx.dijkstra_shortest_paths(graph, one, goal, weight_fn=float)
        if goal not in paths.keys():  # noqa: SIM118
            continue
        steps = [lengths[frozenset(step)] for step in pairwise(paths[goal])]
        found.append((sum(steps) / on_foot, max(steps)))
    return torch.tensor(found).reshape(-1, 2)
