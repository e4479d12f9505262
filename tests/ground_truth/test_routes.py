import networkx as nx
import pytest
import torch
from hypothesis import given, settings, strategies as st

from tests.fakes import MAZES, TINY, parse
from toponav.ground_truth import UNREACHABLE, Routes


def graph_of(mask, closed=()):
    """Return the same maze as a networkx graph, the oracle of distances."""
    free = [tuple(c) for c in mask.nonzero().tolist() if tuple(c) not in set(closed)]
    graph = nx.Graph()
    graph.add_nodes_from(free)
    graph.add_edges_from(
        (cell, other)
        for cell in free
        for other in ((cell[0] + 1, cell[1]), (cell[0], cell[1] + 1))
        if other in graph
    )
    return graph


def check_against_networkx(mask, slots, closed):
    routes = Routes(mask, slot_cells=slots)
    table = routes.tables(torch.tensor([closed], dtype=torch.bool).reshape(1, -1))
    shut = [slot for slot, is_shut in zip(slots, closed, strict=True) if is_shut]
    lengths = dict(nx.all_pairs_shortest_path_length(graph_of(mask, shut)))
    cells = [tuple(cell) for cell in routes.cells.tolist()]
    expected = [
        [lengths.get(start, {}).get(end, UNREACHABLE) for end in cells]
        for start in cells
    ]
    assert routes.distances[table[0]].tolist() == expected


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_distances_agree_with_networkx(data):
    rows, columns = data.draw(st.tuples(st.integers(1, 6), st.integers(1, 6)))
    flat = st.lists(st.booleans(), min_size=rows * columns, max_size=rows * columns)
    mask = torch.tensor(data.draw(flat)).reshape(rows, columns)
    mask[0, 0] = True
    cells = [tuple(cell) for cell in mask.nonzero().tolist()]
    slots = data.draw(st.lists(st.sampled_from(cells), max_size=2, unique=True))
    closed = [data.draw(st.booleans()) for _ in slots]
    check_against_networkx(mask, slots, closed)


@pytest.mark.parametrize("closed", [(False, False), (True, False), (True, True)])
def test_distances_of_maze1_agree_with_networkx(closed):
    mask, slots = parse(MAZES["maze1"])
    check_against_networkx(mask, list(slots.values()), closed)


@pytest.mark.parametrize(
    ("blocked", "length"),
    # The three paths of the paper's maze: 11 cells, 17 with a closed, 27 with b.
    [
        ((False, False), 11),
        ((True, False), 17),
        ((False, True), 27),
        ((True, True), 27),
    ],
)
def test_detours_of_maze1_have_the_lengths_of_the_paper(blocked, length):
    mask, slots = parse(MAZES["maze1"])
    routes = Routes(mask, slot_cells=list(slots.values()))
    table = routes.tables(torch.tensor([blocked]))
    start, goal = routes.number(torch.tensor([[12, 4], [1, 4]]))
    assert routes.distances[table, start, goal].item() == length


def test_path_goes_round_a_closed_slot():
    mask, slots = parse(TINY)
    routes = Routes(mask, slot_cells=list(slots.values()))
    here, goal = routes.number(torch.tensor([[1, 2], [2, 3]])).unsqueeze(1)
    paths = []
    for closed in (False, True):
        table = routes.tables(torch.tensor([[closed]]))
        path = routes.path(table, here, goal, hops=7)[0]
        paths.append(routes.cells[path].tolist())
    assert paths[0][:3] == [[1, 2], [1, 3], [2, 3]]
    assert paths[0][3:] == [[2, 3]] * 5
    assert paths[1][1:7] == [[1, 1], [2, 1], [3, 1], [3, 2], [3, 3], [2, 3]]


def test_path_to_a_cell_cut_off_stays():
    routes = Routes(torch.tensor([[True, False, True]]))
    table = routes.tables(torch.zeros(1, 0, dtype=torch.bool))
    zero, one = torch.tensor([0]), torch.tensor([1])
    assert routes.path(table, zero, one, hops=2).tolist() == [[0, 0, 0]]


def test_each_set_of_closed_slots_has_one_table():
    mask, slots = parse(MAZES["maze1"])
    routes = Routes(mask, slot_cells=list(slots.values()))
    blocked = torch.tensor([[True, False], [False, False], [True, False]])
    first = routes.tables(blocked)
    assert torch.equal(first, routes.tables(blocked))
    assert first[0] == first[2] != first[1]
    assert len(routes.distances) == 2


@pytest.mark.parametrize(
    ("mask", "slots", "message"),
    [
        (torch.ones(2, 2), [], "open_mask must be bool .* got torch.float32"),
        (torch.tensor([[True, False]]), [(0, 1)], "slot_cells must be open cells"),
    ],
)
def test_wrong_arguments_are_refused(mask, slots, message):
    with pytest.raises(ValueError, match=message):
        Routes(mask, slot_cells=slots)


def test_wrong_number_of_slots_is_refused():
    routes = Routes(torch.ones(1, 2, dtype=torch.bool))
    with pytest.raises(ValueError, match="blocked must have 0 slots, got 2"):
        routes.tables(torch.zeros(1, 2, dtype=torch.bool))
