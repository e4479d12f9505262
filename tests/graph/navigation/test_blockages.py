import torch
from hypothesis import given, strategies as st

from toponav.graph.navigation.plans import Blockages

ONE = torch.tensor([True, False])


def edges(*numbers):
    return torch.tensor(numbers)


def test_cuts_are_each_agents_own():
    blockages = Blockages(2, 3)
    blockages.cut(1, edges(0, 2))
    assert blockages.closed.tolist() == [[False] * 3, [True, False, True]]
    assert blockages.num_cuts.tolist() == [0, 1]


def test_the_oldest_cut_opens_first_and_a_later_one_keeps_what_it_closed():
    blockages = Blockages(1, 4)
    blockages.cut(0, edges(0, 1))
    blockages.cut(0, edges(1, 2))
    assert blockages.reopen_oldest(0)
    assert blockages.closed[0].tolist() == [False, True, True, False]
    assert blockages.reopen_oldest(0)
    assert not blockages.closed.any()
    assert not blockages.reopen_oldest(0)


def test_nothing_to_close_is_no_cut():
    blockages = Blockages(1, 2)
    blockages.cut(0, edges())
    assert blockages.num_cuts.tolist() == [0]


def test_cuts_fade_after_so_many_decisions():
    blockages = Blockages(2, 2, fade_after=3)
    blockages.cut(0, edges(1))
    changed = [blockages.pass_decision().tolist() for _ in range(4)]
    # Made at decision 0, open at decision 3.
    assert changed == [[False] * 2, [False] * 2, [True, False], [False] * 2]
    assert not blockages.closed.any()


def test_clearing_takes_some_agents_alone():
    blockages = Blockages(2, 2)
    for agent in (0, 1):
        blockages.cut(agent, edges(0))
    blockages.clear(ONE)
    assert blockages.num_cuts.tolist() == [0, 1]
    assert blockages.closed[:, 0].tolist() == [False, True]


@given(st.lists(st.lists(st.integers(0, 5), min_size=1, unique=True), max_size=5))
def test_opening_all_cuts_opens_all_edges(cuts):
    blockages = Blockages(1, 6)
    for cut in cuts:
        blockages.cut(0, torch.tensor(cut))
    assert blockages.closed[0].sum() == len({edge for cut in cuts for edge in cut})
    while blockages.reopen_oldest(0):
        left = blockages.num_cuts.item()
        still = {edge for cut in cuts[len(cuts) - left :] for edge in cut}
        assert set(blockages.closed[0].nonzero().flatten().tolist()) == still
