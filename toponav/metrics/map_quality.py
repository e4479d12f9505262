"""How good a topological map is, by ground truth that the map itself never sees."""

from collections.abc import Sequence
from dataclasses import dataclass

import rustworkx
import torch
from torch import Tensor

from toponav.ground_truth import GroundTruthDistances, wrap_degrees


@dataclass(frozen=True)
class MapQuality:
    """A map in numbers; shares are in [0, 1], NaN where there is nothing to count."""

    waypoints: int
    edges: int
    coverage: float  # share of the open cells in which a waypoint lies
    false_edges: float  # share of the edges whose ends are far apart on foot
    false_walked_edges: float  # the same among the edges that cost 1
    # Share of the planned paths between random waypoints that contain a false edge.
    false_paths: float
    # Share of the pairs of waypoints that lie close and look the same way, but that no
    # short path joins.
    missing_edges: float
    components: int  # parts of the map that no path joins
    largest_component: float  # share of the waypoints in it
    stretch: float  # median length of a planned path over that of the shortest one
    mean_stretch: float  # its mean, in which paths over false edges weigh more


def map_quality(
    distances: GroundTruthDistances,
    poses: Tensor,
    edges: Tensor,
    edge_cost: Tensor,
    *,
    far_cells: float = 3.0,
    near_cells: float = 1.0,
    near_degrees: float = 45.0,
    hops: int = 3,
    samples: int = 100,
    seed: int = 0,
) -> MapQuality:
    """Judge a map by the poses of its W waypoints.

    Args:
        distances: of the maze.
        poses: ``[W, 3]``, x and y in map units and heading in degrees.
        edges: int64 ``[E, 2]``.
        edge_cost: ``[E]``, by which paths are planned.
        far_cells: an edge is false if its ends are farther apart on foot, in cells.
        near_cells: a pair is close up to this distance on foot, in cells,
        near_degrees: and up to this difference of headings.
        hops: a path of at most so many edges is short.
        samples: random waypoints from which pairs and paths start.
        seed: of the draw.

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
    ends = edges.T.tolist()
    graph.add_edges_from(list(zip(*ends, edge_cost.tolist(), strict=True)))
    parts = [len(part) for part in rustworkx.connected_components(graph)]
    false_length = far_cells * distances.cell_size
    far = edge_lengths(distances, poses, edges) > false_length
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.randperm(len(poses), generator=generator)[:samples].tolist()
    near = (near_cells * distances.cell_size, near_degrees)
    stretches, leads_wrong = _planned_paths(
        distances, poses, graph, drawn, false_length, generator
    ).unbind(1)
    return MapQuality(
        waypoints=len(poses),
        edges=len(edges),
        coverage=float(covered_cells(distances, poses).float().mean()),
        false_edges=float(far.float().mean()),
        false_walked_edges=float(far[edge_cost <= 1].float().mean()),
        false_paths=float(leads_wrong.mean()),
        missing_edges=_missing(distances, poses, graph, drawn, near, hops),
        components=len(parts),
        largest_component=max(parts, default=0) / max(len(poses), 1),
        stretch=float(stretches.median()) if len(stretches) else float("nan"),
        mean_stretch=float(stretches.mean()),
    )


def covered_cells(distances: GroundTruthDistances, poses: Tensor) -> Tensor:
    """In which open cells of `Routes` one of the poses lies, bool ``[N]``."""
    covered = torch.zeros(len(distances.routes.cells), dtype=torch.bool)
    if len(poses):
        covered[distances.cell_numbers(poses[:, :2])] = True
    return covered


def edge_lengths(
    distances: GroundTruthDistances, poses: Tensor, edges: Tensor
) -> Tensor:
    """How far the ends of each edge are apart on foot, map units ``[E]``."""
    if not len(edges):
        return torch.zeros(0)
    one, other = poses[edges.T, :2]
    return distances.geodesic(one, other)


def _missing(
    distances: GroundTruthDistances,
    poses: Tensor,
    graph: rustworkx.PyGraph,
    drawn: Sequence[int],
    near: tuple[float, float],
    hops: int,
) -> float:
    distance, angle = near
    found: list[bool] = []
    for one in drawn:
        turned = wrap_degrees(poses[:, 2] - poses[one, 2]).abs() <= angle
        beside = (poses[:, :2] - poses[one, :2]).norm(dim=-1) <= distance
        others = (turned & beside).nonzero().flatten()
        others = others[others != one]
        if not len(others):
            continue
        away = distances.geodesic(poses[one, :2], poses[others, :2])
        reached = {one}
        for _ in range(hops):
            reached |= {far for node in reached for far in graph.neighbors(node)}
        found += [other not in reached for other in others[away <= distance].tolist()]
    return sum(found) / len(found) if found else float("nan")


def _planned_paths(
    distances: GroundTruthDistances,
    poses: Tensor,
    graph: rustworkx.PyGraph,
    drawn: Sequence[int],
    false_length: float,
    generator: torch.Generator,
) -> Tensor:
    """Stretch of planned paths between random waypoints, and 1 for false ones."""
    found: list[tuple[float, float]] = []
    if len(poses) < 2:
        return torch.tensor(found).reshape(-1, 2)
    for one in drawn:
        further = int(torch.randint(1, len(poses), (), generator=generator))
        goal = (one + further) % len(poses)
        shortest = float(distances.geodesic(poses[one, :2], poses[goal, :2]))
        # A detour of a step would weigh too much on a path of two.
        if shortest < 2 * distances.cell_size:
            continue
        paths = rustworkx.dijkstra_shortest_paths(graph, one, goal, weight_fn=float)
        if goal not in paths.keys():  # noqa: SIM118
            continue
        path = torch.tensor(list(paths[goal]))
        steps = torch.stack([path[:-1], path[1:]], 1)
        lengths = edge_lengths(distances, poses, steps)
        is_false = bool((lengths > false_length).any())
        found.append((float(lengths.sum()) / shortest, float(is_false)))
    return torch.tensor(found).reshape(-1, 2)
