"""`TopologicalMap`: what becomes a waypoint, and what an edge."""

from itertools import combinations, pairwise

import pytest
import torch
from hypothesis import given, settings, strategies as st
from tensordict import TensorDict

from tests.graph.grey_world import PlainMap, embed, episode, make_map
from toponav.keys import NETWORKS_VERSION

# Their similarities are exact in float32, so that ties are ties.
SCALE = 128
# So few shades that a view is often like two waypoints.
SHADES = st.lists(st.integers(0, 48), min_size=1, max_size=25)
RULES = st.fixed_dictionaries(
    {
        "window": st.integers(0, 2),
        "search_window": st.integers(0, 2),
        "hysteresis": st.booleans(),
        "edges": st.sampled_from(["both", "reach", "time"]),
        "extend_by": st.sampled_from(["itself", "previous"]),
        "edge_steps": st.integers(1, 6),
    }
)
# Between any two of their means.
OFF = {"tc_threshold": 0.9037, "tc_reach": 0.7537}


def edges_of(topological_map):
    """Edges and traversals as plain lists."""
    edges = [tuple(pair) for pair in topological_map.edges.tolist()]
    return edges, dict(
        zip(edges, topological_map.graph.traversals.sum(1).tolist(), strict=True)
    )


def test_the_first_episode_is_simplified_by_elimination() -> None:
    # 5 and 8 are like 0 (0.95, 0.92); 20 is like nothing (0.8); 26 is like 20 (0.94);
    # 60 is like nothing.
    topological_map = make_map()
    assert topological_map.add_episode(episode(0, 5, 20, 26, 60, 8)).tolist() == [
        0,
        0,
        1,
        1,
        2,
        0,
    ]
    assert topological_map.num_waypoints == 3
    assert topological_map.embeddings.flatten().tolist() == pytest.approx(
        [0.0, 0.2, 0.6]
    )
    # 0 and 20 reach each other (0.8 > 0.75) and were walked; the others only walked.
    assert topological_map.edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert topological_map.graph.edge_similarity[0].item() == pytest.approx(0.8)
    assert topological_map.graph.edge_similarity[1:].isnan().all()
    # From 60 back to 0, and from 0 to 20 to 60.
    assert topological_map.edge_cost.tolist() == [[1, 3], [3, 1], [1, 3]]
    assert topological_map.waypoints.origins.tolist() == [[0, 0], [0, 2], [0, 4]]


def test_an_edge_that_was_only_seen_is_dearer() -> None:
    topological_map = make_map(untraversed_edge_cost=2.5)
    topological_map.add_episode(episode(0, 22, 44))
    # 11 is a waypoint, 0.89 like 0 and 22: it reaches both, but not 44 (0.67). 70 is
    # reached by none (0.74 from 44) and walked to from 11.
    assert topological_map.add_episode(episode(11, 70)).tolist() == [3, 4]
    assert topological_map.edges.tolist() == [[0, 1], [0, 3], [1, 2], [1, 3], [3, 4]]
    assert topological_map.edge_cost.amin(1).tolist() == [1.0, 2.5, 1.0, 2.5, 1.0]
    assert topological_map.edge_cost.amax(1).tolist() == [2.5] * 5


def test_steps_make_no_edges_where_only_reach_does() -> None:
    topological_map = make_map(edges="reach")
    assert topological_map.add_episode(episode(0, 60, 0, 20, 0)).tolist() == [
        0,
        1,
        0,
        2,
        0,
    ]
    # 20 reaches 0 (0.8); 20 becomes a waypoint once and is left once: both steps count.
    assert edges_of(topological_map) == ([(0, 2)], {(0, 2): 2})


def test_waypoints_up_to_so_many_decisions_apart_are_joined() -> None:
    greys = episode(0, 0, 30, 60, 60, 90)
    found = {}
    for steps in (1, 2, 3, 4):
        topological_map = make_map(edges="time", edge_steps=steps)
        assert topological_map.add_episode(greys).tolist() == [0, 0, 1, 2, 2, 3]
        found[steps] = [tuple(pair) for pair in topological_map.edges.tolist()]
    chain = [(0, 1), (1, 2), (2, 3)]
    assert found[1] == chain
    # From the last 0 to the first 60 it is two decisions, 30 to 90 three, 0 to 90 four.
    assert found[2] == sorted([*chain, (0, 2)])
    assert found[3] == sorted([*chain, (0, 2), (1, 3)])
    assert found[4] == sorted([*chain, (0, 2), (1, 3), (0, 3)])
    # Each was walked once, from the first to the last.
    assert topological_map.graph.traversals.tolist() == [[1, 0]] * 6
    # Nothing is joined across the end of an episode.
    topological_map.add_episode(episode(45))
    assert topological_map.add_episode(episode(75)).tolist() == [5]
    assert topological_map.edges.max() == 3


@settings(deadline=None, max_examples=60)
@given(st.lists(SHADES, min_size=1, max_size=3), st.integers(1, 6))
def test_edges_by_time_are_all_pairs_of_views_within_the_steps(episodes, steps) -> None:
    topological_map, joined = make_map(edges="time", edge_steps=steps, **OFF), set()
    for greys in episodes:
        places = topological_map.add_episode(episode(*greys, scale=SCALE)).tolist()
        for (i, one), (j, other) in combinations(enumerate(places), 2):
            if j - i <= steps and one != other:
                joined.add((min(one, other), max(one, other)))
    assert edges_of(topological_map)[0] == sorted(joined)


def test_where_the_view_before_makes_the_edges_time_adds_steps_alone() -> None:
    topological_map = make_map(extend_by="previous", edge_steps=3)
    topological_map.add_episode(episode(0, 30, 60))
    assert topological_map.edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    # Eq. 12 in later episodes: the view before each reaches its own place alone.
    assert topological_map.add_episode(episode(0, 90, 45)).tolist() == [0, 3, 4]
    assert topological_map.edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [3, 4]]


def test_of_episodes_that_begin_side_by_side_one_is_the_first() -> None:
    topological_map = make_map(extend_by="previous", edge_steps=3)
    beside = [episode(0, 30, 60, env=0), episode(90, 45, 15, env=1)]
    topological_map.extend(torch.stack(beside))
    shades = (topological_map.embeddings.flatten() * 100).round().int()
    pairs = {tuple(sorted(pair)) for pair in shades[topological_map.edges].tolist()}
    # Eq. 10 joins two that are two decisions apart, eq. 12 only what the view before
    # reaches: 45 reaches 30, 60 and itself when 15 is seen.
    assert (0, 60) in pairs
    assert {pair for pair in pairs if pair[0] == 15} == {(15, 30), (15, 45), (15, 60)}


def test_a_new_waypoint_of_a_later_episode_is_linked_by_the_view_before() -> None:
    # Eq. 12: 40 was seen after 22, which reaches 0 and itself; 40 reaches 22 alone.
    by_previous, by_itself = make_map(extend_by="previous"), make_map()
    for topological_map in (by_previous, by_itself):
        topological_map.add_episode(episode(0, 22))
        topological_map.add_episode(episode(22, 40))
    assert by_previous.edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert by_itself.edges.tolist() == [[0, 1], [1, 2]]


def test_with_hysteresis_a_view_stays_where_the_last_one_was() -> None:
    # 7 is 0.93 like 0 and 0.92 like 15, where it comes from.
    views = episode(0, 15, 7)
    assert make_map().add_episode(views).tolist() == [0, 1, 0]
    assert make_map(hysteresis=True).add_episode(views).tolist() == [0, 1, 1]


def test_neighbouring_views_outvote_a_single_one() -> None:
    # The 60 in the middle is a glitch. Its vote for 0: (1 + 0.4 + 1) / 3 = 0.8; with
    # five, (4 + 0.4) / 5 = 0.88.
    views = episode(0, 0, 0, 60, 0, 0, 0)
    assert make_map().add_episode(views).tolist() == [0, 0, 0, 1, 0, 0, 0]
    wide = make_map(window=2, tc_threshold=0.85)
    assert wide.add_episode(views).tolist() == [0] * 7


def test_a_leap_must_be_backed_by_more_views() -> None:
    # Back at 0 for one view: alone it is 0, with its neighbours (0.5 + 1 + 0.5) / 3.
    views = episode(0, 50, 50, 0, 50, 50)
    assert make_map().add_episode(views).tolist() == [0, 1, 1, 0, 1, 1]
    # Then 50 again, with (0.5 + 1 + 1) / 3: no leap either, but a waypoint of its own.
    backed = make_map(nearby=1, search_window=1)
    assert backed.add_episode(views).tolist() == [0, 1, 1, 2, 3, 3]


@settings(deadline=None, max_examples=40)
@given(st.lists(SHADES, min_size=1, max_size=3), RULES)
def test_it_does_what_the_plain_map_does(episodes, rules) -> None:
    topological_map, plain = (
        make_map(**OFF, **rules),
        PlainMap(scale=SCALE, **OFF, **rules),
    )
    for greys in episodes:
        assert topological_map.add_episode(
            episode(*greys, scale=SCALE)
        ).tolist() == plain.add(greys)
    edges, traversals = edges_of(topological_map)
    assert edges == plain.edges()
    assert {
        edge: count for edge, count in traversals.items() if count
    } == plain.traversed


@settings(deadline=None, max_examples=25)
@given(SHADES, st.sets(st.integers(1, 30)), RULES)
def test_where_batches_are_cut_makes_no_difference(greys, cuts, rules) -> None:
    whole, pieces = make_map(**OFF, **rules), make_map(**OFF, **rules)
    data = episode(*greys, views=True, env=3, scale=SCALE)
    whole.add_episode(data)
    ends = [0, *sorted(cut for cut in cuts if cut < len(greys)), len(greys)]
    for start, stop in pairwise(ends):
        pieces.extend(data[start:stop].unsqueeze(0))
    one, other = whole.state_dict(), pieces.state_dict()
    for name in ("embeddings", "images", "origins", "edges", "traversals"):
        assert torch.equal(one[name], other[name]), name


def test_each_environment_goes_on_where_it_was() -> None:
    # Two environments whose rows change places from batch to batch.
    first, second = episode(0, 0, 30, 30, env=4), episode(70, 70, 99, 99, env=9)
    topological_map = make_map(edges="time")
    assert topological_map.extend(torch.stack([first[:2], second[:2]])) == 2
    assert topological_map.extend(torch.stack([second[2:], first[2:]])) == 2
    assert topological_map.edges.tolist() == [[0, 3], [1, 2]]
    assert topological_map.waypoints.origins.tolist() == [
        [4, 0],
        [9, 0],
        [9, 2],
        [4, 2],
    ]


def test_a_whole_episode_does_not_go_on_from_what_is_unfinished() -> None:
    # Two views wait for more around them, and a whole episode of the same environment
    # comes, as far from them as can be.
    topological_map = make_map(window=2)
    walk = episode(0, 0, 0, 0, env=0)
    topological_map.extend(walk[None, :3])
    assert topological_map.add_episode(episode(100, 100)).tolist() == [1, 1]
    assert topological_map.edges.tolist() == []
    # The first was seen before three, and the second after them.
    assert topological_map.waypoints.origins.tolist() == [[0, 0], [0, 3]]


def test_nothing_joins_two_episodes_nor_both_sides_of_a_respawn() -> None:
    one, two = episode(0, 30, env=0), episode(60, 90, env=0)
    topological_map = make_map(edges="time")
    topological_map.extend(torch.cat([one, two]).unsqueeze(0))
    assert topological_map.edges.tolist() == [[0, 1], [2, 3]]
    data = episode(0, 30, 60, 90, env=0)
    data["next", "reward"] = torch.tensor([[0.0], [10.0], [1.0], [0.0]])
    for goal_reward, edges in (
        (10.0, [[0, 1], [2, 3]]),
        (None, [[0, 1], [1, 2], [2, 3]]),
    ):
        topological_map = make_map(edges="time", goal_reward=goal_reward)
        topological_map.extend(data.unsqueeze(0))
        assert topological_map.edges.tolist() == edges


def test_views_of_other_networks_are_embedded_again() -> None:
    data = episode(0, 30, views=True, env=0)
    data["embedding"] = data["embedding"] + 0.5  # what other networks made of them
    data[NETWORKS_VERSION] = torch.ones(2, 1, dtype=torch.int64)
    topological_map = make_map()
    topological_map.extend(data.unsqueeze(0))
    assert topological_map.embeddings.flatten().tolist() == pytest.approx([0.0, 0.3])
    with pytest.raises(
        ValueError, match="must have 'network_pixels' to embed again, got versi"
    ):
        make_map().extend(data.exclude("network_pixels").unsqueeze(0))


def test_the_keys_of_a_batch_can_be_others() -> None:
    data = episode(0, 30, 60, views=True, env=5)
    usual, other = make_map(), make_map()
    usual.extend(data.unsqueeze(0))
    names = {"network_pixels": "views", "embedding": ("vision", "code"), "env_id": "id"}
    renamed = data.clone()
    for old, new in names.items():
        renamed.rename_key_(old, new)
    renamed["next", "is_over"] = renamed["next"].pop("done")
    other.set_keys(
        views="views", embedding=("vision", "code"), env_id="id", done="is_over"
    )
    other.extend(renamed.unsqueeze(0))
    assert torch.equal(usual.waypoints.images, other.waypoints.images)
    assert torch.equal(usual.waypoints.origins, other.waypoints.origins)
    assert torch.equal(usual.edges, other.edges)
    with pytest.raises(ValueError, match=r"some of \['embedding', .*, got 'pixels'"):
        other.set_keys(pixels="views")


def test_new_networks_judge_edges_and_what_is_unfinished_again() -> None:
    scale = {"by": 1.0}

    def embed_scaled(views):
        return embed(views) * scale["by"]

    topological_map = make_map()
    topological_map.waypoints._embed = embed_scaled
    # 0-20 is walked; 40 reaches 20 (0.8).
    topological_map.add_episode(episode(0, 20, 0, views=True))
    topological_map.add_episode(episode(40, views=True))
    assert edges_of(topological_map)[0] == [(0, 1), (1, 2)]
    scale["by"] = 2.0
    # 20 and 40 are now 0.6 alike: never walked, dropped. 0 and 20 too, but walked.
    assert topological_map.refresh(1) == 1
    assert edges_of(topological_map)[0] == [(0, 1)]
    assert topological_map.graph.edge_similarity.tolist() == pytest.approx([0.6])
    assert topological_map.embeddings.flatten().tolist() == pytest.approx(
        [0.0, 0.4, 0.8]
    )
    assert topological_map.network_version == 1


def test_similarities_are_those_of_the_networks() -> None:
    topological_map = make_map()
    topological_map.add_episode(episode(0, 30, 60))
    views = torch.tensor([[0.0], [0.5]])
    known = topological_map.waypoints.similarities(views)
    assert known.flatten().tolist() == pytest.approx([1.0, 0.7, 0.4, 0.5, 0.8, 0.9])
    some = topological_map.waypoints.similarities(views, torch.tensor([2, 0]))
    assert torch.equal(some, known[:, [2, 0]])
    assert make_map().waypoints.similarities(views).shape == (2, 0)


def test_a_shortlist_finds_what_all_comparisons_find() -> None:
    torch.manual_seed(0)
    greys = torch.randint(0, 101, (300,)).tolist()
    maps = [make_map(nearby=1, shortlist=some, edges="time") for some in (None, 3)]
    places = [
        topological_map.add_episode(episode(*greys)).tolist()
        for topological_map in maps
    ]
    assert places[0] == places[1]
    assert maps[0].num_waypoints > 5


def test_the_state_goes_from_map_to_map() -> None:
    topological_map, other = make_map(), make_map()
    topological_map.add_episode(episode(0, 30, 60, views=True))
    topological_map.network_version = 7
    other.load_state_dict(topological_map.state_dict())
    for name, value in topological_map.state_dict().items():
        if isinstance(value, torch.Tensor):
            assert torch.equal(
                value.nan_to_num(-1), other.state_dict()[name].nan_to_num(-1)
            )
        else:
            assert value == other.state_dict()[name]
    both = [
        one.add_episode(episode(61, 90, views=True)).tolist()
        for one in (topological_map, other)
    ]
    assert both[0] == both[1] == [2, 3]


def test_another_map_of_the_same_version_is_a_change() -> None:
    # Both have counted two waypoints and an edge.
    topological_map, other = make_map(), make_map()
    topological_map.add_episode(episode(0, 20))
    other.add_episode(episode(40, 60))
    before = topological_map.version
    assert other.version == before
    topological_map.load_state_dict(other.state_dict())
    assert topological_map.version != before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tc_threshold": 1.0}, r"tc_threshold must be in \[0, 1\), got 1"),
        ({"tc_reach": 0.95}, r"in \[0, tc_threshold=0.9\], got 0.95"),
        ({"edges": "all"}, "edges must be one of"),
        ({"extend_by": "next"}, "extend_by must be one of"),
        ({"window": -1}, "window must be at least 0, got -1"),
        ({"search_window": -1}, "search_window must be at least 0, got -1"),
        ({"nearby": 0}, "nearby must be at least 1, got 0"),
        ({"shortlist": 0}, "shortlist must be at least 1, got 0"),
        (
            {"untraversed_edge_cost": 0.5},
            "untraversed_edge_cost must be at least 1, got 0.5",
        ),
    ],
)
def test_an_argument_out_of_range_is_refused(arguments, message) -> None:
    with pytest.raises(ValueError, match=message):
        make_map(**arguments)


@pytest.mark.parametrize(
    ("break_", "message"),
    [
        (lambda data: data[0], r"must be \[E, T >= 1\], got \[2\]"),
        (lambda data: data.exclude("env_id"), "must have 'env_id'"),
        (lambda data: data.exclude("next"), r"must have \('next', 'done'\)"),
        (
            lambda data: data.exclude("embedding"),
            "must have 'embedding' or 'network_pixels'",
        ),
    ],
)
def test_data_that_says_too_little_is_refused(break_, message) -> None:
    data = episode(0, 30, env=0).unsqueeze(0)
    with pytest.raises(ValueError, match=message):
        make_map().extend(break_(data))


def test_broken_networks_are_noticed() -> None:
    data = episode(0, 30, env=0)
    data["embedding"][1] = float("nan")
    with pytest.raises(ValueError, match="embeddings must be finite, got NaN"):
        make_map().add_episode(data)
    topological_map = make_map()
    topological_map.waypoints._compare = lambda one, many: 2 + 0 * many[..., 0]
    topological_map.add_episode(episode(0))
    with pytest.raises(ValueError, match=r"must be in \[0, 1\], got 2 to 2"):
        topological_map.add_episode(episode(0))


def test_an_episode_must_have_observations() -> None:
    with pytest.raises(ValueError, match=r"an episode must be \[T >= 1\], got \[0\]"):
        make_map().add_episode(TensorDict(batch_size=[0]))


def test_a_place_found_in_a_search_must_fit_what_lies_around_it() -> None:
    # 50 lies between 20 and 80 in the first episode. In the second one it lies between
    # 110 and 120 (a wall that looks the same elsewhere), in the third as in the first.
    episodes = (
        episode(0, 20, 20, 50, 80, 80),
        episode(110, 110, 110, 50, 120, 120),
        episode(20, 20, 20, 50, 80, 80),
    )
    rules = {"nearby": 1, "surroundings": 2, "surroundings_above": 0.85}
    plain, careful = make_map(nearby=1), make_map(**rules)
    for one in episodes:
        found, judged = plain.add_episode(one), careful.add_episode(one)
        if one is episodes[1]:
            # 50 is taken for the one that is known; among 110s and 120s, whose likeness
            # to 20, 50 and 80 is at most 0.7, it becomes a waypoint of its own.
            assert found[3] == 2
            assert judged[3] == judged[0] + 1
    # Both ends of the third lie around the 50 of the first.
    assert found[3] == judged[3] == 2
    with pytest.raises(ValueError, match=r"surroundings_above must be in \[0, 1\)"):
        make_map(surroundings_above=1.0)
