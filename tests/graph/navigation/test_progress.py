import torch
from hypothesis import given, strategies as st

from toponav.graph.navigation.progress import Progress


def make_progress(patience, agents=1):
    return Progress(agents, patience=patience)


def watch(progress, left, place=3):
    return progress.watch(
        torch.tensor([place]), torch.tensor([float(left)], dtype=torch.float64)
    ).item()


def test_who_comes_no_nearer_is_stuck_from_then_on():
    progress = make_progress(4)
    found = [watch(progress, left) for left in (9, 8, 7, 6, 6, 6, 6, 6, 5)]
    # Medians of two are the lower ones: 9 8|7 6, 8 7|6 6, 7 6|6 6, 6 6|6 6 twice,
    # and then 6 6|6 5.
    assert found == [False] * 5 + [True, True, True, False]


def test_mistaken_places_are_neither_progress_nor_frontier():
    progress = make_progress(16)
    lefts = [5, 6] * 8
    lefts[3], lefts[12] = 1, 30
    found = [watch(progress, left, place=left) for left in lefts]
    assert found == [False] * 15 + [True]
    # One in eight of 16, two, may be lower; only one is, so that the third is a 5.
    assert progress.give_up(0) == (5, 5.0, 0)


def test_the_frontier_leaves_one_in_eight_out():
    progress = make_progress(16)
    for left in range(16, 0, -1):
        watch(progress, left, place=100 + left)
    # Of 16 the two lowest: the third is 3.
    assert progress.give_up(0) == (103, 3.0, 0)


def stuck_at(progress, left, most=99):
    """Decisions until the agent is stuck, and the reach of what it gives up."""
    for decision in range(1, most):
        if watch(progress, left):
            return decision, progress.give_up(0)[2]
    raise AssertionError("never stuck")


def test_each_cut_that_follows_soon_reaches_farther():
    progress = make_progress(4)
    assert [stuck_at(progress, 9) for _ in range(4)] == [(4, 0), (4, 1), (4, 3), (4, 7)]
    # Steady progress over more than twice the patience: then it begins again.
    for left in range(9, 0, -1):
        assert not watch(progress, left)
    assert stuck_at(progress, 1)[1] == 0


def test_a_cut_elsewhere_begins_again():
    progress = make_progress(4)
    for _ in range(2):
        stuck_at(progress, 9)
    progress.restart(torch.tensor([True]))
    assert stuck_at(progress, 9) == (4, 3)
    progress.forget(torch.tensor([True]))
    assert stuck_at(progress, 9) == (4, 0)


def test_a_new_way_is_watched_anew():
    progress = make_progress(3, agents=2)
    place, left = torch.tensor([1, 2]), torch.tensor([4.0, 4.0]).double()
    for _ in range(2):
        assert not progress.watch(place, left).any()
    progress.restart(torch.tensor([True, False]))
    assert progress.watch(place, left).tolist() == [False, True]


def test_the_lost_and_those_at_the_goal_do_not_count():
    progress = make_progress(2)
    for place, left in ((-1, torch.inf), (-1, 3.0), (4, 0.0), (4, torch.inf)):
        assert not any(watch(progress, left, place) for _ in range(5))
    assert [watch(progress, 3.0) for _ in range(2)] == [False, True]


def test_no_patience_never_gives_up():
    progress = make_progress(None)
    assert not any(watch(progress, 5.0) for _ in range(99))


@given(st.integers(2, 9), st.lists(st.integers(0, 3), min_size=1, max_size=40))
def test_steady_progress_is_never_stuck(patience, pauses):
    # A step nearer at least with every second decision of half the patience.
    progress = make_progress(patience)
    left = 1000.0
    for _ in pauses:
        left -= 1
        assert not watch(progress, left)
