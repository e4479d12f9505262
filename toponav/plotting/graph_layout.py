"""`lay_out`: places for the waypoints of a map that has none, from its edges alone."""

import networkx
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra, laplacian
from scipy.sparse.linalg import spsolve

# Springs move every waypoint by all others: a second for some hundred of them, minutes
# for thousands.
_BY_SPRINGS = 400


def lay_out(num: int, edges: ArrayLike, *, seed: int = 0) -> NDArray[np.float64]:
    """Places in which neighbours are close, ``[num, 2]``; ``edges`` are ``[E, 2]``.

    Springs unfold a small map. Of a large one they unfold some hundred waypoints alone,
    joined where the parts of the map around them are; each other one comes to lie in
    the middle of its neighbours. Of very many parts the small ones lie around the rest.

    Examples:
        >>> lay_out(3, [[0, 1], [1, 2]]).shape
        (3, 2)
    """
    ends = np.asarray(edges, np.int64).reshape(-1, 2)
    if num <= _BY_SPRINGS:
        return _by_springs(num, ends, seed)
    joined = csr_array((np.ones(len(ends)), tuple(ends.T)), shape=(num, num))
    joined += joined.T
    parts, part = connected_components(joined, directed=False)
    if parts > _BY_SPRINGS // 2:
        return _large_parts_inside(ends, part, seed)
    # One of each part at least: what no edge joins with one of them has no middle.
    order = np.random.default_rng(seed).permutation(num)
    first = order[np.unique(part[order], return_index=True)[1]]
    rest = order[~np.isin(order, first)][: _BY_SPRINGS - parts]
    chosen = np.sort(np.concatenate([first, rest]))
    around = dijkstra(
        joined, indices=chosen, unweighted=True, min_only=True, return_predecessors=True
    )[2]
    number = np.searchsorted(chosen, around)
    between = np.unique(np.sort(number[ends], 1), axis=0)
    fixed = _by_springs(len(chosen), between[between[:, 0] != between[:, 1]], seed)
    return _in_the_middle(joined, chosen, fixed)


def _by_springs(num: int, ends: NDArray[np.int64], seed: int) -> NDArray[np.float64]:
    graph = networkx.empty_graph(num)
    graph.add_edges_from(ends.tolist())
    layout = networkx.spring_layout(graph, iterations=60, seed=seed)
    return np.array(list(layout.values()), np.float64).reshape(-1, 2)


def _large_parts_inside(
    ends: NDArray[np.int64], part: NDArray[np.int32], seed: int
) -> NDArray[np.float64]:
    """The largest parts laid out, and each other ``part`` in one place on a circle."""
    by_size = np.argsort(-np.bincount(part), kind="stable")
    inside = np.isin(part, by_size[: _BY_SPRINGS // 2])
    number = np.cumsum(inside) - 1
    turn = 2 * np.pi * np.argsort(by_size)[part] / len(by_size)
    # What is inside reaches from -1 to 1.
    places = 1.6 * np.stack([np.cos(turn), np.sin(turn)], 1)
    within = number[ends[inside[ends[:, 0]]]]
    places[inside] = lay_out(int(inside.sum()), within, seed=seed)
    return places


def _in_the_middle(
    joined: csr_array, chosen: NDArray[np.int64], fixed: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Places of all, those of the ``chosen`` ones being ``fixed`` at first."""
    places = np.empty((joined.shape[0], 2))
    places[chosen] = fixed
    others = np.setdiff1d(np.arange(len(places)), chosen)
    pull = csr_array(laplacian(joined))[others]
    # For each of them, the sum of the ways to its neighbours is 0.
    places[others] = spsolve(pull[:, others].tocsc(), -(pull[:, chosen] @ fixed))
    # They draw together, away from those that hold them, which follow.
    weight = 1 + np.asarray(joined.sum(1))[chosen, None]
    places[chosen] = (fixed + joined[chosen] @ places) / weight
    return places
