import torch
from hypothesis import given, strategies as st

from toponav.graph.navigation.progress import EdgeProgress, Progress


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


def test_the_reach_of_a_hundred_cuts_in_a_row_is_a_number():
    # 2^100 - 1 edges would be no int64.
    progress = make_progress(2)
    for _ in range(100):
        watch(progress, 5), watch(progress, 5)
        *_, reach = progress.give_up(0)
    assert 2**31 < reach < 2**63


def test_a_cut_elsewhere_begins_again():
    progress = make_progress(4)
    for _ in range(2):
        stuck_at(progress, 9)
    progress.restart(torch.tensor([True]))
    assert stuck_at(progress, 9) == (4, 3)
    progress.forget(torch.tensor([True]))
    assert stuck_at(progress, 9) == (4, 0)


def test_a_new_way_is_watched_from_its_beginning():
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


def watch_all(progress, places, lefts):
    return [
        watch(progress, left, place=place)
        for place, left in zip(places, lefts, strict=True)
    ]


def test_the_edge_ahead_is_the_one_from_where_the_agent_came_nearest():
    progress = EdgeProgress(1, patience=3)
    # Nearest at 7, two decisions from the goal; 8 and 9 are detours.
    found = watch_all(progress, [6, 7, 8, 9, 8], [3, 2, 3, 4, 3])
    assert found == [False, False, False, True, True]
    assert progress.give_up(0) == (7, 2.0, None)
    # Then it begins again, wherever it is.
    assert watch_all(progress, [9, 9, 9], [5, 5, 5]) == [False, False, True]
    assert progress.give_up(0) == (9, 5.0, None)


def test_by_edges_the_lost_and_those_at_the_goal_do_not_count():
    progress = EdgeProgress(2, patience=2)
    none = torch.tensor([-1, 4]), torch.tensor([torch.inf, 0.0]).double()
    some = torch.tensor([5, 5]), torch.tensor([3.0, 3.0]).double()
    assert not any(progress.watch(*none).any() for _ in range(5))
    assert progress.watch(*some).tolist() == [False, False]
    progress.restart(torch.tensor([True, False]))
    assert progress.watch(*none).tolist() == [False, False]
    assert progress.watch(*some).tolist() == [False, True]
    progress = EdgeProgress(1, patience=None)
    assert not any(watch(progress, 5.0) for _ in range(99))


@given(st.lists(st.integers(1, 9), min_size=1, max_size=60), st.integers(1, 9))
def test_by_edges_it_is_stuck_as_a_plain_count_says(lefts, patience):
    progress = EdgeProgress(1, patience=patience)
    for at, left in enumerate(lefts):
        first = lefts.index(min(lefts[: at + 1]))
        assert watch(progress, left) == (at - first + 1 >= patience)
