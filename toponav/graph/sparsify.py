"""`sparsify`: fewer waypoints, by merging those that stand for the same place."""

import torch
from torch import Tensor

from toponav.graph.topological_map import TopologicalMap


def sparsify(topological_map: TopologicalMap, *, tolerance: float = 0.1) -> Tensor:
    """Merge neighbours that agree with each other about all their neighbours.

    A waypoint becomes part of an older neighbour if each of the two passes
    ``tc_threshold`` of the other, and if to and from every neighbour of either one
    their similarities differ by at most ``tolerance``, in [0, 1]. Newest first; nothing
    becomes part of a waypoint that goes itself, so that no chain of small differences
    makes a large one. Returns the new number of each waypoint, int64 ``[W]``.

    Reference:
        The paper leaves sparser maps to future work. Merging where both directions
        agree is the rule of Emmons et al., "Sparse Graphical Memory for Robust
        Planning" (2020). https://arxiv.org/abs/2003.06417
    """
    if not 0 <= tolerance <= 1:
        raise ValueError(f"tolerance must be in [0, 1], got {tolerance}")
    into = torch.arange(topological_map.num_waypoints)
    edges = topological_map.edges
    there_and_back = _similarity(topological_map, *edges.unbind(1))
    similar = (there_and_back > topological_map.tc_threshold).all(0)
    takes, goes = set[int](), set[int]()
    for older, newer in sorted(edges[similar].tolist(), key=lambda pair: -pair[1]):
        if newer in takes or newer in goes or older in goes:
            continue
        if _agree(topological_map, older, newer, tolerance):
            into[newer] = older
            takes.add(older)
            goes.add(newer)
    return topological_map.merge(into)


def _similarity(topological_map: TopologicalMap, one: Tensor, other: Tensor) -> Tensor:
    compare = topological_map.waypoints.pair_similarities
    return torch.stack([compare(one, other), compare(other, one)])


def _agree(
    topological_map: TopologicalMap, one: int, other: int, tolerance: float
) -> bool:
    """Whether two waypoints are equally similar to each neighbour of either."""
    graph = topological_map.graph
    around = {*graph.neighbours(one), *graph.neighbours(other)} - {one, other}
    if not around:
        return True
    third = torch.tensor(sorted(around))
    first, second = (
        _similarity(topological_map, torch.full_like(third, end), third)
        for end in (one, other)
    )
    return float((first - second).abs().max()) <= tolerance
