import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from tests.transforms.colour_world import (
    PlainMemory,
    compare,
    embed,
    flags,
    make_memory,
    reset,
    shade,
    step,
)
from toponav.keys import EMBEDDING, IS_NEW_WAYPOINT, NOVEL, SIMILARITY, VISITS, WAYPOINT
from toponav.transforms import WaypointMemory

# Grey in 64ths, so that similarities are exact in float32.
greys = st.integers(0, 64).map(lambda number: number / 64)


def walk(memory, way):
    """Reset one env at the first grey, go on to the others; the flags of each."""
    start = reset(memory, shade(way[0]))
    return [flags(start), *(flags(step(memory, shade(grey))) for grey in way[1:])]


def column(memory, way, key):
    reset(memory, shade(way[0]))
    return [step(memory, shade(grey))[key].item() for grey in way[1:]]


def test_worked_numbers():
    # waypoint, similarity, novel, is new, visits, number of waypoints
    assert walk(make_memory(), [0.0, 0.125, 0.5, 0.5, 0.375, 0.0]) == [
        (0, 0.0, True, True, 1, 1),  # the first view is the first waypoint
        (0, 0.875, False, False, 2, 1),  # 1 - 0.125 > 0.8
        (1, 0.5, True, True, 1, 2),  # 1 - 0.5, a new waypoint
        (1, 1.0, False, False, 2, 2),
        (1, 0.875, False, False, 3, 2),  # 0.125 from 0.5, 0.375 from 0.0
        (0, 1.0, False, False, 3, 2),
    ]


def test_at_the_threshold_a_view_is_novel():
    assert column(make_memory(threshold=0.75), [0.0, 0.25], NOVEL) == [True]
    assert column(make_memory(threshold=0.74), [0.0, 0.25], NOVEL) == [False]


def test_ties_go_to_the_lower_index():
    memory = make_memory(threshold=0.7)
    assert column(memory, [0.0, 0.5, 0.25], WAYPOINT) == [1, 0]


def test_the_embedding_is_written():
    memory = make_memory()
    assert reset(memory, shade(0.25, 0.5))[EMBEDDING].tolist() == [[0.25], [0.5]]
    assert step(memory, shade(0.75, 1.0))[EMBEDDING].tolist() == [[0.75], [1.0]]


def test_persistence_makes_only_the_last_of_several_a_waypoint():
    memory = make_memory(persistence=3)
    way = [0.0, 0.5, 0.5, 0.0, 0.5, 0.75, 1.0, 0.5]
    found = walk(memory, way)[1:]
    # The known view in between starts the row again; nothing is counted while waiting.
    assert [(f[0], f[2], f[3], f[4]) for f in found] == [
        (-1, True, False, 0),
        (-1, True, False, 0),
        (0, False, False, 2),
        (-1, True, False, 0),
        (-1, True, False, 0),
        (1, True, True, 1),
        (-1, True, False, 0),
    ]


def test_min_gap_spaces_new_waypoints():
    memory = make_memory(min_gap=3)
    # The first view is a new waypoint, too: decision 3 is the first that may add one.
    way = [0.0, 0.5, 1.0, 0.5, 1.0, 1.0, 1.0]
    new_waypoints = column(memory, way, IS_NEW_WAYPOINT)
    assert new_waypoints == [False, False, True, False, False, True]


def test_count_on_entry_counts_only_another_waypoint():
    memory = make_memory(count_on="entry")
    way = [0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.5]
    assert column(memory, way, VISITS) == [0, 1, 0, 2, 0, 2]


def test_a_novel_view_between_is_no_way_to_enter_again():
    memory = make_memory(count_on="entry", persistence=9)
    assert column(memory, [0.0, 0.5, 0.0, 0.5, 0.0], VISITS) == [0, 0, 0, 0]


def test_a_full_memory_takes_no_new_waypoint():
    memory = make_memory(capacity=2)
    assert column(memory, [0.0, 0.5, 1.0, 1.0], IS_NEW_WAYPOINT) == [True, False, False]


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_it_does_what_plain_python_does(data):
    arguments = data.draw(
        st.fixed_dictionaries(
            {
                "threshold": st.sampled_from([0.5, 0.75, 0.875, 0.95]),
                "capacity": st.sampled_from([1, 3, 20]),
                "persistence": st.integers(1, 3),
                "min_gap": st.integers(1, 3),
                "count_on": st.sampled_from(["every", "entry"]),
            }
        )
    )
    num_envs = data.draw(st.integers(1, 3))
    views = st.lists(greys, min_size=num_envs, max_size=num_envs)
    masks = st.lists(st.booleans(), min_size=num_envs, max_size=num_envs).filter(any)
    memory = make_memory(**arguments)
    plain = [PlainMemory(**arguments) for _ in range(num_envs)]
    start = data.draw(views)
    found = reset(memory, shade(*start))
    wanted = [env.reset(grey) for env, grey in zip(plain, start, strict=True)]
    for _ in range(data.draw(st.integers(0, 25))):
        assert [flags(found, env) for env in range(num_envs)] == wanted
        now = data.draw(views)
        if data.draw(st.integers(0, 9)) == 0:
            rows = data.draw(masks)
            found = reset(memory, shade(*now), rows)
            for env, restarts in enumerate(rows):
                if restarts:
                    assert flags(found, env) == plain[env].reset(now[env])
            now = data.draw(views)
        found = step(memory, shade(*now))
        wanted = [env.step(grey) for env, grey in zip(plain, now, strict=True)]


@settings(max_examples=20, deadline=None)
@given(way=st.lists(greys, min_size=2, max_size=20))
def test_each_new_waypoint_makes_its_own_view_known(way):
    # So that no view is paid as a new place in two decisions in a row.
    memory = make_memory(threshold=0.9)
    reset(memory, shade(way[0]))
    for grey in way[1:]:
        is_new_waypoint = step(memory, shade(grey))[IS_NEW_WAYPOINT].item()
        again = step(memory, shade(grey))
        assert not again[NOVEL].item()
        assert not (is_new_waypoint and again[IS_NEW_WAYPOINT].item())


def test_prepared_entries_are_what_is_compared():
    seen = []

    def prepare(memory):
        seen.append(memory.shape)
        return torch.cat([memory, -memory], -1)

    def compare_prepared(one, prepared):
        assert (prepared[..., 0] == -prepared[..., 1]).all()
        return compare(one, prepared[..., :1])

    memory = WaypointMemory(embed, compare_prepared, prepare=prepare, threshold=0.8)
    way = [0.0, 0.125, 0.5, 0.5, 0.375, 0.0]
    assert walk(memory, way) == walk(make_memory(), way)
    # Once for the first view and once for the new waypoint.
    assert seen == [(1, 1, 1), (1, 1, 1)]


def test_a_reset_of_nobody_changes_nothing():
    memory = make_memory()
    reset(memory, shade(0.0, 0.0))
    reset(memory, shade(1.0, 1.0), [False, False])
    assert flags(step(memory, shade(0.0, 0.0))) == (0, 1.0, False, False, 2, 1)


def test_only_as_many_slots_are_compared_as_are_in_use():
    lengths = []

    def looked_at(one, many):
        lengths.append(many.shape[1])
        return compare(one, many)

    memory = WaypointMemory(embed, looked_at, threshold=0.8)
    reset(memory, shade(0.0, 0.0))
    for now in ((0.0, 0.5), (0.0, 1.0), (0.0, 1.0)):
        step(memory, shade(*now))
    assert lengths == [1, 2, 3]
    reset(memory, shade(0.0, 0.0))
    step(memory, shade(0.0, 0.0))
    # The next decision knows that nobody has more than one.
    step(memory, shade(0.0, 0.0))
    assert lengths[-1] == 1


def test_earlier_results_do_not_change_afterwards():
    memory = make_memory()
    first = reset(memory, shade(0.0, 0.0))
    then = step(memory, shade(0.5, 0.0))
    before = first.clone(), then.clone()
    step(memory, shade(1.0, 0.5))
    reset(memory, shade(0.0, 0.0))
    assert (first == before[0]).all()
    assert (then == before[1]).all()


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_broken_embeddings_are_named(number):
    memory = make_memory()
    with pytest.raises(
        ValueError, match=r"embed must return finite numbers, .* 1 of 2"
    ):
        reset(memory, shade(number, 0.0))
    reset(memory, shade(0.0, 0.0))
    with pytest.raises(ValueError, match="embed must return finite"):
        step(memory, shade(0.0, number))


@pytest.mark.parametrize("wrong", [math.nan, -0.5, 1.5])
def test_broken_similarities_are_named(wrong):
    memory = WaypointMemory(embed, lambda one, many: compare(one, many) * wrong)
    reset(memory, shade(0.0))
    with pytest.raises(ValueError, match=r"compare must return .* in \[0, 1\], got"):
        step(memory, shade(0.0))


def test_rounding_beyond_one_is_one():
    memory = WaypointMemory(embed, lambda one, many: compare(one, many) + 1e-6)
    reset(memory, shade(0.0))
    assert step(memory, shade(0.0))[SIMILARITY].item() == 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"threshold": 1.0}, r"threshold must be in \[0, 1\), got 1.0"),
        ({"threshold": -0.1}, r"threshold must be in \[0, 1\), got -0.1"),
        ({"capacity": 0}, "capacity must be at least 1, got 0"),
        ({"persistence": 0}, "persistence must be at least 1, got 0"),
        ({"min_gap": 0}, "min_gap must be at least 1, got 0"),
        ({"count_on": "exit"}, "count_on must be one of .* got 'exit'"),
        ({"out_keys": ["a"]}, "in_keys must be 1 and out_keys 7"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        make_memory(**arguments)


def test_a_step_without_a_reset_is_refused():
    with pytest.raises(
        ValueError, match="reset of the same envs, \\[1\\], got one of \\[0\\]"
    ):
        step(make_memory(), shade(0.5))
