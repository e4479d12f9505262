"""`sparsify`: fewer waypoints, by merging those that stand for the same place."""

import torch
from torch import Tensor

from toponav.graph.topological_map import TopologicalMap


def sparsify(grown: TopologicalMap, *, tolerance: float = 0.1) -> Tensor:
    """Merge neighbours that agree with each other about all their neighbours.

    A waypoint becomes part of an older neighbour if each of the two passes
    ``tc_threshold`` of the other, and if to and from every neighbour of either one
    their similarities differ by at most ``tolerance``: seen from the map they are one
    place. Edges of what goes pass to what stays, with their traversals. Newest first;
    nothing becomes part of a waypoint that goes itself, so that no chain of small
    differences makes a large one.

    Reference:
        The paper leaves sparser maps to future work. Merging where both directions
        agree is the rule of Emmons et al., "Sparse Graphical Memory for Robust
        Planning" (2020). https://arxiv.org/abs/2003.06417

    Args:
        grown: the map; changed in place.
        tolerance: how much two similarities may differ, in [0, 1].

    Returns:
        int64 ``[W]``, the new number of each waypoint.

    Raises:
        ValueError: if ``tolerance`` is out of range.

    Examples:
        Waypoints on a line, compared by how far apart they are:

        >>> from tensordict import TensorDict
        >>> place = torch.tensor([0.0, 0.1, 1.0]).reshape(3, 1)
        >>> compare = lambda one, many: 1 - (one.unsqueeze(1) - many).abs().mean(-1) / 2
        >>> grown = TopologicalMap(
        ...     embed=lambda views: views.flatten(1).float(),
        ...     compare=compare,
        ...     tc_threshold=0.97,
        ...     tc_reach=0.5,
        ...     window=0,
        ...     search_window=0,
        ... )
        >>> grown.add_episode(TensorDict({"embedding": place}, [3]))
        tensor([0, 1, 2])
        >>> grown.rules.set_thresholds(0.9, 0.5)
        >>> sparsify(grown), grown.edges
        (tensor([0, 0, 1]), tensor([[0, 1]]))

    Shape notation:
        W: waypoints before.
    """
    if not 0 <= tolerance <= 1:
        raise ValueError(f"tolerance must be in [0, 1], got {tolerance}")
    into = torch.arange(grown.num_waypoints)
    ends = grown.edges
    alike = (_both_ways(grown, ends) > grown.tc_threshold).all(0)
    takes, goes = set[int](), set[int]()
    for older, newer in sorted(ends[alike].tolist(), key=lambda pair: -pair[1]):
        if newer in takes or newer in goes or older in goes:
            continue
        if _agree(grown, older, newer, tolerance):
            into[newer] = older
            takes.add(older)
            goes.add(newer)
    return grown.merge(into)


def _both_ways(grown: TopologicalMap, pairs: Tensor) -> Tensor:
    """Similarity of each pair in both directions, ``[2, A]``."""
    one, other = pairs.unbind(1)
    compare = grown.waypoints.pair_similarities
    return torch.stack([compare(one, other), compare(other, one)])


def _agree(grown: TopologicalMap, one: int, other: int, tolerance: float) -> bool:
    """Whether two waypoints are like each neighbour of either to the same degree."""
    around = {*grown.graph.neighbours(one), *grown.graph.neighbours(other)}
    third = torch.tensor(sorted(around - {one, other}), dtype=torch.int64)
    if not len(third):
        return True
    ways = [
        _both_ways(grown, torch.stack([torch.full_like(third, end), third], 1))
        for end in (one, other)
    ]
    return float((ways[0] - ways[1]).abs().max()) <= tolerance
