"""Maps that know which way the agent turned, and edges of what it surely saw."""

import math

import pytest
import torch

from tests.graph.grey_world import compare, embed, episode
from toponav.graph import MapRules, TopologicalMap, load_map, save_map
from toponav.graph.headings import agreed_angle, look_alike

#: Ahead, 90 degrees to the left, 90 to the right.
TURNS = torch.tensor([0.0, 90.0, -90.0])
AHEAD, LEFT, RIGHT = 0, 1, 2


def make_map(**rules):
    chosen = {"tc_threshold": 0.9, "tc_reach": 0.75, "edges": "time", "shortlist": None}
    chosen |= {"window": 0, "search_window": 0, "hysteresis": False, "nearby": None}
    chosen |= {"turn_tolerance": 30.0} | rules
    return TopologicalMap(embed, compare, MapRules(**chosen), turns=TURNS)


def walk(greys, actions, **more):
    data = episode(*greys, **more)
    return data.set("action", torch.tensor(actions))


def test_a_view_that_is_not_known_may_look_any_way():
    known = torch.tensor([0.0, 29.0, 31.0, 331.0, math.nan])
    found = look_alike(known, torch.tensor(0.0), 30.0)
    assert found.tolist() == [True, True, False, True, True]


def test_an_angle_needs_votes_that_agree():
    # 9 of 20 are enough, 8 of 20 are not; the others are 32 degrees apart or more.
    others = torch.tensor([0.0, 32, 64, 140, 172, 204, 236, 268, 300, 332, 34])
    votes = torch.cat([torch.full((9,), 105.0), others])
    assert agreed_angle(votes) == pytest.approx(105)
    votes[0] = 66.0
    assert agreed_angle(votes) is None
    assert agreed_angle(torch.full((15,), 100.0)) is None
    assert agreed_angle(torch.empty(0)) is None


def test_the_same_view_another_way_is_another_waypoint():
    # Black, then a turn to the left, and black again: a corner of four alike walls.
    greys, actions = (0, 0, 0, 0, 0), (LEFT, LEFT, LEFT, LEFT, AHEAD)
    grown = make_map()
    assert grown.add_episode(walk(greys, actions)).tolist() == [0, 1, 2, 3, 0]
    assert grown.waypoints.headings.tolist() == [0.0, 90.0, 180.0, 270.0]
    # Without the turns they are one.
    plain = make_map(turn_tolerance=None)
    assert plain.add_episode(walk(greys, actions)).tolist() == [0] * 5
    assert plain.waypoints.headings.isnan().all()


def test_turns_reach_over_batches():
    grown = make_map()
    whole = walk((0, 0, 0, 0), (LEFT, AHEAD, RIGHT, AHEAD), env=0)
    for part in whole.unsqueeze(0).split([1, 2, 1], 1):
        grown.extend(part)
    # 0, then 90, 90 after the turn, and 0 again.
    assert grown.waypoints.headings.tolist() == [0.0, 90.0]


#: Shades of a corridor, each of them seen in one direction.
WAYS = 44


def corridor(start, length, **more):
    """Shades two apart, seen in turns to the left from number ``start`` on."""
    ways = torch.arange(start, start + length) % WAYS
    return walk((ways * 2).tolist(), [LEFT] * length, **more)


def corridor_map():
    grown = make_map(tc_threshold=0.985)
    assert grown.add_episode(corridor(0, WAYS, views=True)).tolist() == [*range(WAYS)]
    return grown


def test_a_later_episode_finds_out_which_way_it_looks():
    grown = corridor_map()
    # It begins with the view of 90 degrees. One frame in six votes, for every second
    # waypoint, of 150 22.
    found = grown.add_episode(corridor(1, 150))
    assert found.tolist() == [number % WAYS for number in range(1, 151)]
    assert grown.num_waypoints == WAYS


def test_an_episode_that_does_not_find_out_is_left_out():
    grown = corridor_map()
    # 60 frames have ten votes.
    assert grown.add_episode(corridor(1, 60)).tolist() == [-1] * 60
    assert grown.num_waypoints == WAYS


def test_what_waits_for_its_direction_is_decided_once_it_has_one():
    grown = corridor_map()
    later = corridor(1, 150, views=True)
    later["env_id"] = torch.zeros(150, 1, dtype=torch.int64)
    before = grown.graph.traversals.sum().item()
    counts = []
    for part in later.unsqueeze(0).split(50, 1):
        assert grown.extend(part) == 0
        counts.append(grown.graph.traversals.sum().item() - before)
    # 50 frames have nine votes, 100 have 17, and are 99 steps.
    assert counts == [0, 99, 149]


def test_maps_keep_their_headings(tmp_path):
    grown, other = corridor_map(), make_map(tc_threshold=0.985)
    save_map(grown.state_dict(), tmp_path / "map.zip")
    other.load_state_dict(load_map(tmp_path / "map.zip")[0])
    assert other.waypoints.headings.tolist() == [0.0, 90.0, 180.0, 270.0] * 11
    state = grown.state_dict()
    del state["headings"]  # as in earlier checkpoints
    other.load_state_dict(state)
    assert other.waypoints.headings.isnan().all()
    # Then any heading fits.
    assert other.add_episode(corridor(2, 4)).tolist() == [2, 3, 4, 5]


def test_actions_must_be_there():
    with pytest.raises(ValueError, match="batches must have 'action'"):
        make_map().add_episode(episode(0, 1))


def test_edges_join_what_was_surely_seen():
    # 0, then 6 (0.94 like 0, not sure), then 20 (a waypoint), then 12 (0.92 like 20 and
    # 0.88 like 0), 20 itself, and 0.
    greys = (0, 6, 20, 12, 20, 0)
    loose = make_map(turn_tolerance=None)
    assert loose.add_episode(episode(*greys)).tolist() == [0, 0, 1, 1, 1, 0]
    assert loose.graph.traversals.tolist() == [[1, 1]]
    sure = make_map(turn_tolerance=None, edge_threshold=0.95, edge_gap=2)
    assert sure.add_episode(episode(*greys)).tolist() == [0, 0, 1, 1, 1, 0]
    # From 0 to 20 it took two decisions, from 20 back to 0 one.
    assert sure.graph.traversals.tolist() == [[1, 1]]
    near = make_map(turn_tolerance=None, edge_threshold=0.95, edge_gap=1)
    near.add_episode(episode(*greys))
    assert near.graph.traversals.tolist() == [[0, 1]]


def test_a_view_that_is_not_sure_makes_no_edge():
    # 0; 20; 26 is at 20 (0.94); 34 is a waypoint (0.86); 28 is at 34 (0.94), and so on
    # to 8, which is at 0 (0.92): an agent that is nowhere exactly goes nowhere.
    greys = (0, 20, 26, 34, 28, 8)
    rules = {"turn_tolerance": None, "edge_threshold": 0.95, "edge_gap": 12}
    grown = make_map(**rules)
    assert grown.add_episode(episode(*greys)).tolist() == [0, 1, 1, 2, 2, 0]
    assert grown.edges.tolist() == [[0, 1], [1, 2]]
    loose = make_map(turn_tolerance=None)
    loose.add_episode(episode(*greys))
    assert loose.edges.tolist() == [[0, 1], [0, 2], [1, 2]]


def test_a_merge_keeps_where_the_agent_surely_was():
    rules = {"turn_tolerance": None, "edge_threshold": 0.95}
    grown = make_map(**rules)
    data = episode(0, 20, 40, env=0)
    data["next", "done"][:] = False
    grown.extend(data.unsqueeze(0))
    # 20 becomes part of 0, and 40 gets the number 1.
    grown.merge(torch.tensor([0, 0, 2]))
    then = episode(60, env=0)
    grown.extend(then.unsqueeze(0))
    assert grown.edges.tolist() == [[0, 1], [1, 2]]


@pytest.mark.parametrize(
    ("rule", "value", "message"),
    [
        ("turn_tolerance", -1.0, "turn_tolerance must be at least 0, got -1"),
        ("edge_threshold", 1.0, r"edge_threshold must be in \[0, 1\), got 1"),
        ("edge_gap", 0, "edge_gap must be at least 1, got 0"),
    ],
)
def test_rules_out_of_range_are_refused(rule, value, message):
    with pytest.raises(ValueError, match=message):
        make_map(**{rule: value})


def test_of_episodes_that_begin_together_one_has_the_maps_direction():
    # Two agents in one corridor, of which the second begins at 90 degrees. It waits
    # until its views are on the map, and then adds nothing.
    grown = make_map(tc_threshold=0.985)
    first, second = corridor(0, 150), corridor(1, 150)
    for env, one in enumerate((first, second)):
        one["env_id"] = torch.full((150, 1), env)
    for part in torch.stack([first, second]).split(50, 1):
        grown.extend(part)
    assert grown.waypoints.headings.tolist() == [0.0, 90.0, 180.0, 270.0] * 11


def test_a_map_that_lost_its_first_episode_takes_the_direction_of_the_next():
    # The first view waits for 16 more, which do not come.
    grown = make_map(surroundings=16)
    grown.extend(walk((0, 0), (AHEAD, AHEAD), env=0)[None, :1])
    grown.end_episodes([0])
    grown.extend(walk((0, 50), (AHEAD, AHEAD), env=0)[None])
    assert grown.waypoints.headings.tolist() == [0.0, 0.0]


def test_a_map_that_became_empty_takes_a_new_direction():
    grown = make_map()
    empty = grown.state_dict()
    for _ in range(2):
        assert grown.add_episode(walk((0, 50), (LEFT, AHEAD))).tolist() == [0, 1]
        assert grown.waypoints.headings.tolist() == [0.0, 90.0]
        grown.load_state_dict(empty)


def test_after_a_resume_one_episode_has_the_maps_direction():
    begun, resumed = make_map(surroundings=16), make_map(surroundings=16)
    # No view of the first agent is decided yet, when the run is cut off.
    begun.extend(corridor(0, 99, env=0)[None, :9])
    resumed.load_state_dict(begun.state_dict())
    resumed.resume_episodes(begun.running_episodes())
    # The second one waits until its views are on the map.
    resumed.extend(corridor(1, 99, env=1)[None, :9])
    tracks = resumed.running_episodes()["tracks"]
    assert [track["oriented"] for track in tracks] == [True, False]
