"""`sparsify`: a map of fewer waypoints, by their similarities alone."""

import torch
from torch import Tensor

from toponav.graph.topological_map import TopologicalMap


def sparsify(topological_map: TopologicalMap, *, tolerance: float = 0.1) -> Tensor:
    """Merge neighbours that agree with each other about all their neighbours.

    A waypoint becomes part of an older neighbour if each of the two passes
    ``tc_threshold`` of the other, and if to and from every neighbour of either one
    their similarities differ by at most ``tolerance``, in [0, 1]. Newest first; nothing
    becomes part of what goes itself. Returns the new number of each, int64 ``[W]``.

    Reference:
        The paper leaves sparser maps to future work. Merging where both directions
        agree is the rule of Emmons et al., "Sparse Graphical Memory for Robust
        Planning" (2020). https://arxiv.org/abs/2003.06417
    """
    if not 0 <= tolerance <= 1:
        raise ValueError(f"tolerance must be in [0, 1], got {tolerance}")
    compare = topological_map.waypoints.pair_similarities
    neighbours = topological_map.graph.neighbours

    def similarity(one: Tensor, other: Tensor) -> Tensor:
        return torch.stack([compare(one, other), compare(other, one)])

    def difference(one: int, other: int) -> float:
        """Of two waypoints' similarities to the neighbours of either, at most."""
        around = {*neighbours(one), *neighbours(other)} - {one, other}
        if not around:
            return 0.0
        third = torch.tensor(sorted(around))
        first = similarity(torch.full_like(third, one), third)
        second = similarity(torch.full_like(third, other), third)
        return float((first - second).abs().max())

    into = torch.arange(topological_map.num_waypoints)
    edges = topological_map.edges
    are_alike = similarity(*edges.unbind(1)) > topological_map.rules.tc_threshold
    takes, goes = set[int](), set[int]()
    pairs = sorted(edges[are_alike.all(0)].tolist(), key=lambda pair: -pair[1])
    for older, newer in pairs:
        if newer in takes or newer in goes or older in goes:
            continue
        if difference(older, newer) <= tolerance:
            into[newer] = older
            takes.add(older)
            goes.add(newer)
    return topological_map.merge(into)
