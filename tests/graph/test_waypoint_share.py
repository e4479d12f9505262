import pytest
import torch
from hypothesis import given, settings, strategies as st

from tests.comparing_networks import Lookup, Nearness
from tests.graph.grey_world import compare, embed, episode
from toponav.graph import (
    MapRules,
    TopologicalMap,
    WalkWaypoints,
    share_curve,
)


def eliminate(table, threshold):
    """Keep what resembles no earlier waypoint, word by word."""
    kept = []
    for time in range(len(table)):
        if all(table[time, waypoint] <= threshold for waypoint in kept):
            kept.append(time)
    return kept


def random_walk(length, seed):
    steps = torch.randn(length, 2, generator=torch.Generator().manual_seed(seed))
    return steps.cumsum(0)


@settings(max_examples=40, deadline=None)
@given(
    length=st.integers(1, 90),
    seed=st.integers(0, 999),
    threshold=st.floats(0.0, 1.0),
    smooth=st.booleans(),
)
def test_elimination_agrees_with_its_definition(length, seed, threshold, smooth):
    generator = torch.Generator().manual_seed(seed)
    table = torch.rand(length, length, generator=generator)
    if smooth:  # as in a walk: what is old is matched only by a return
        at = random_walk(length, seed)
        table = 1 / (1 + torch.cdist(at, at))
    network = Lookup(table)
    walk = WalkWaypoints(network.sequence, network)
    assert walk.times(threshold) == eliminate(table, threshold)


def test_observation_is_judged_against_the_memory_not_the_reverse():
    # Row: the observation. Observation 1 resembles waypoint 0 only that way round.
    network = Lookup([[1.0, 0.0], [0.9, 1.0]])
    assert WalkWaypoints(network.sequence, network).share(0.5) == 0.5


@given(threshold=st.floats(-1.0, 1.0), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_first_observation_is_always_a_waypoint(threshold, seed):
    walk = random_walk(12, seed)
    assert WalkWaypoints(walk, Nearness()).times(threshold)[0] == 0


def test_similarity_at_the_threshold_makes_a_waypoint():
    network = Lookup([[1.0, 0.5], [0.5, 1.0]])
    assert WalkWaypoints(network.sequence, network).share(0.5) == 1.0
    assert WalkWaypoints(network.sequence, network).share(0.4999) == 0.5


def test_share_may_fall_when_the_threshold_rises():
    # Below .6 observation 1 is covered by 0, and 2, 3, 4 are places of their own:
    # 0, 2, 3, 4. Above, 1 is a waypoint, and covers the three.
    table = torch.eye(5)
    table[1, 0] = 0.6
    table[2:, 1] = 0.9
    network = Lookup(table)
    walk = WalkWaypoints(network.sequence, network)
    shares = share_curve([walk], [0.5, 0.7])
    assert shares.tolist() == [[4 / 5, 2 / 5]]


def test_extreme_thresholds_keep_all_or_one():
    walk = random_walk(50, 0)
    walks = [WalkWaypoints(one, Nearness()) for one in (walk, walk[:20])]
    shares = share_curve(walks, [-0.1, 1.0])
    torch.testing.assert_close(shares, torch.tensor([[0.02, 1], [0.05, 1]]).double())


def test_waypoints_beyond_the_recent_ones_still_cover():
    # 100 far-off views lie between the first place and the return to it.
    away = 1000.0 * torch.arange(1, 101)
    line = torch.cat([torch.zeros(1), away, torch.zeros(3)]).unsqueeze(1)
    assert WalkWaypoints(line, Nearness()).times(0.5) == list(range(101))


def test_the_similarities_are_the_upper_half_of_a_matrix():
    at = random_walk(300, 1)
    later = torch.from_numpy(WalkWaypoints(at, Nearness()).later)
    matrix = 1 / (1 + torch.cdist(at, at, compute_mode="donot_use_mm_for_euclid_dist"))
    upper = torch.ones(300, 300, dtype=torch.bool).triu(1)
    torch.testing.assert_close(later[upper], matrix[upper])
    assert (later[~upper] == -1).all()


def test_a_map_by_the_papers_rules_keeps_the_same_waypoints():
    class Greys:
        def prepare_memory(self, memory):
            return memory

        def compare_prepared(self, embedding, prepared):
            return compare(embedding, prepared)

    greys = torch.randint(101, (200,), generator=torch.Generator().manual_seed(1))
    rules = MapRules(
        tc_threshold=0.9,
        tc_reach=0.5,
        window=0,
        search_window=0,
        hysteresis=False,
        nearby=None,
        shortlist=None,
    )
    topological_map = TopologicalMap(embed, compare, rules)
    data = episode(*greys.tolist())
    topological_map.add_episode(data)
    times = WalkWaypoints(data["embedding"], Greys()).times(0.9)
    assert topological_map.waypoints.origins[:, 1].tolist() == times


def test_order_of_observation_matters_but_naming_does_not():
    # A shift of the whole walk changes no distance, hence no waypoint.
    walk = random_walk(80, 2)
    times = WalkWaypoints(walk, Nearness()).times(0.3)
    assert WalkWaypoints(walk + 5, Nearness()).times(0.3) == times


@pytest.mark.parametrize("shape", [(0, 3), (4,), (2, 4, 3)])
def test_sequence_must_be_a_matrix(shape):
    with pytest.raises(ValueError, match=r"a sequence must be embeddings \[T, D\]"):
        WalkWaypoints(torch.zeros(shape), Nearness())


def test_nan_is_refused():
    walk = random_walk(5, 0)
    walk[3] = torch.nan
    with pytest.raises(ValueError, match="got NaN"):
        WalkWaypoints(walk, Nearness())
