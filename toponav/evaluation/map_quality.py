"""How good a topological map is, by the truth that the map itself never sees.

- `map_quality`, `MapQuality`: coverage, false and missing edges, components, stretch.
- `covered_cells`, `edge_lengths`: what those are made of.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import rustworkx
import torch
from torch import Tensor

from toponav.evaluation.pair_truth import MazeMetric
from toponav.evaluation.steering import wrap_degrees


@dataclass(frozen=True)
class MapQuality:
    """A map in numbers; shares are in [0, 1], NaN where there is nothing to count.

    Args:
        waypoints: their number.
        edges: their number.
        coverage: share of the open cells in which a waypoint lies.
        false_edges: share of the edges whose ends are far apart for a walker: false
            shortcuts.
        false_walked_edges: the same among the edges that cost 1.
        false_ways: share of the planned paths between random waypoints that lead over a
            false edge: shortcuts draw the cheapest paths to them.
        missing_edges: share of the pairs of waypoints that lie close and look the same
            way, but that no short path joins: the agent could go, the map cannot say.
        components: parts of the map that no path joins.
        largest_component: share of the waypoints in the largest part.
        stretch: median length of a planned path over the shortest way.
        mean_stretch: its mean, in which paths over false edges weigh more.
    """

    waypoints: int
    edges: int
    coverage: float
    false_edges: float
    false_walked_edges: float
    false_ways: float
    missing_edges: float
    components: int
    largest_component: float
    stretch: float
    mean_stretch: float


def map_quality(
    metric: MazeMetric,
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
    """Judge a map by the poses of its waypoints.

    Missing edges, false ways and stretch are counted from ``samples`` waypoints drawn
    at random, or from all if there are fewer.

    Args:
        metric: of the maze.
        poses: ``[W, 3]``, x and y in map units and heading in degrees.
        edges: int64 ``[E, 2]``.
        edge_cost: ``[E]``, by which paths are planned.
        far_cells: an edge is false if its ends are farther apart on foot, in cells.
        near_cells: a pair is close up to this distance on foot, in cells,
        near_degrees: and up to this difference of headings.
        hops: a path of at most so many edges is short.
        samples: waypoints to start from.
        seed: of the draw.

    Raises:
        ValueError: if the shapes do not fit or a waypoint lies in a wall.

    Examples:
        Four waypoints along a corridor of six cells; the last edge spans four of them:

        >>> metric = MazeMetric(torch.ones(1, 6, dtype=torch.bool))
        >>> x = torch.tensor([64.0, 96.0, 192.0, 704.0])
        >>> poses = torch.stack([x, torch.full((4,), 64.0), torch.zeros(4)], 1)
        >>> edges = torch.tensor([[0, 2], [1, 2], [2, 3]])
        >>> quality = map_quality(metric, poses, edges, torch.ones(3))
        >>> quality.coverage, quality.false_edges, quality.missing_edges
        (0.5, 0.3333..., 0.0)

    Shape notation:
        W: waypoints.  E: edges.
    """
    if poses.ndim != 2 or poses.shape[1] != 3:
        raise ValueError(f"poses must be [W, 3], got {list(poses.shape)}")
    if edges.shape != (len(edge_cost), 2):
        raise ValueError(
            f"edges must be [{len(edge_cost)}, 2] as edge_cost has "
            f"{len(edge_cost)}, got {list(edges.shape)}"
        )
    graph = _make_graph(len(poses), edges, edge_cost)
    parts = [len(part) for part in rustworkx.connected_components(graph)]
    false_length = far_cells * metric.cell_size
    far = edge_lengths(metric, poses, edges) > false_length
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.randperm(len(poses), generator=generator)[:samples].tolist()
    near = (near_cells * metric.cell_size, near_degrees)
    ways = _planned_ways(metric, poses, graph, drawn, false_length, generator)
    stretches, leads_wrong = ways.unbind(1)
    return MapQuality(
        waypoints=len(poses),
        edges=len(edges),
        coverage=float(covered_cells(metric, poses).float().mean()),
        false_edges=float(far.float().mean()),
        false_walked_edges=float(far[edge_cost <= 1].float().mean()),
        false_ways=float(leads_wrong.mean()),
        missing_edges=_missing(metric, poses, graph, drawn, near, hops),
        components=len(parts),
        largest_component=max(parts, default=0) / max(len(poses), 1),
        stretch=float(stretches.median()) if len(stretches) else float("nan"),
        mean_stretch=float(stretches.mean()),
    )


def covered_cells(metric: MazeMetric, poses: Tensor) -> Tensor:
    """In which open cells a waypoint lies.

    Args:
        metric: of the maze.
        poses: ``[W, 2]`` or more columns, x and y first, in map units.

    Returns:
        bool ``[N]``, in the order of ``metric.routes.cells``.
    """
    covered = torch.zeros(len(metric.routes.cells), dtype=torch.bool)
    if len(poses):
        covered[metric.cell_numbers(poses[:, :2])] = True
    return covered


def edge_lengths(metric: MazeMetric, poses: Tensor, edges: Tensor) -> Tensor:
    """How far the ends of each edge are apart on foot, map units ``[E]``."""
    if not len(edges):
        return torch.zeros(0)
    one, other = poses[edges.T, :2]
    return metric.geodesic(one, other)


def _make_graph(num: int, edges: Tensor, edge_cost: Tensor) -> rustworkx.PyGraph:
    graph = rustworkx.PyGraph(multigraph=False)
    graph.add_nodes_from(range(num))
    told = zip(edges.tolist(), edge_cost.tolist(), strict=True)
    graph.add_edges_from([(one, other, cost) for (one, other), cost in told])
    return graph


def _missing(
    metric: MazeMetric,
    poses: Tensor,
    graph: rustworkx.PyGraph,
    drawn: Sequence[int],
    near: tuple[float, float],
    hops: int,
) -> float:
    """Share of the close pairs, one of ``drawn`` in each, without a short path."""
    distance, angle = near
    pairs = missing = 0
    for one in drawn:
        turned = wrap_degrees(poses[:, 2] - poses[one, 2]).abs() <= angle
        beside = (poses[:, :2] - poses[one, :2]).norm(dim=-1) <= distance
        others = (turned & beside).nonzero().flatten()
        others = others[others != one]
        if not len(others):
            continue
        away = metric.geodesic(poses[one, :2].expand(len(others), 2), poses[others, :2])
        close = others[away <= distance].tolist()
        reached = _within(graph, one, hops)
        pairs += len(close)
        missing += sum(other not in reached for other in close)
    return missing / pairs if pairs else float("nan")


def _within(graph: rustworkx.PyGraph, start: int, hops: int) -> set[int]:
    """Waypoints at most so many edges away."""
    found, front = {start}, {start}
    for _ in range(hops):
        front = {other for one in front for other in graph.neighbors(one)} - found
        found |= front
    return found


def _planned_ways(
    metric: MazeMetric,
    poses: Tensor,
    graph: rustworkx.PyGraph,
    drawn: Sequence[int],
    false_length: float,
    generator: torch.Generator,
) -> Tensor:
    """Planned paths between random waypoints, ``[N, 2]``.

    Their length on foot over that of the shortest way, and 1 for those with a step
    that is longer than ``false_length``, else 0.
    """
    found: list[tuple[float, float]] = []
    if len(poses) < 2:
        return torch.tensor(found).reshape(-1, 2)
    for one in drawn:
        further = int(torch.randint(1, len(poses), (), generator=generator))
        goal = (one + further) % len(poses)
        shortest = float(metric.geodesic(poses[one, :2], poses[goal, :2]))
        # A detour of a step would weigh too much on a way of two.
        if shortest < 2 * metric.cell_size:
            continue
        paths = rustworkx.dijkstra_shortest_paths(graph, one, goal, weight_fn=float)
        if goal not in paths.keys():  # noqa: SIM118
            continue
        way = torch.tensor(list(paths[goal]))
        steps = torch.stack([way[:-1], way[1:]], 1)
        lengths = edge_lengths(metric, poses, steps)
        is_false = bool((lengths > false_length).any())
        found.append((float(lengths.sum()) / shortest, float(is_false)))
    return torch.tensor(found).reshape(-1, 2)
