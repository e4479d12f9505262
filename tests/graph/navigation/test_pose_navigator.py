"""A navigator that knows poses, in a corridor with two corners that look alike."""

from math import cos, radians, sin
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from tests.graph.poses.ring_world import EFFECTS, compare, is_free, look
from toponav.graph import (
    BeliefRules,
    MapRules,
    NavigatorRules,
    PoseMap,
    PoseNavigator,
    PractisingNavigator,
)
from toponav.graph.poses import BEARINGS
from toponav.keys import (
    ACTION,
    GOAL_VIEWS,
    IS_INIT,
    LOST,
    PATH_COST,
    PIXELS,
    PLACE,
    PREVIOUS_REWARD,
)
from toponav.methods.navigators.topological import NavigatorMap

# The middle of the corridor, every 2 steps from one corner to the next, and in each of
# four directions.
SIDE = [2.5 + 2.2 * step for step in range(6)]
ROUND = [
    *[(x, 2.5) for x in SIDE[:-1]],
    *[(13.5, y) for y in SIDE[:-1]],
    *[(x, 13.5) for x in SIDE[:0:-1]],
    *[(2.5, y) for y in SIDE[:0:-1]],
]
HEADINGS = (0.0, 90.0, 180.0, 270.0)
POSES = torch.tensor([[*place, turn] for place in ROUND for turn in HEADINGS])
VIEWS = torch.tensor([look(*pose) for pose in POSES.tolist()])


def edges() -> torch.Tensor:
    """Turns on the spot, and steps to the next place without a turn."""
    number, turns = len(ROUND), len(HEADINGS)
    found = []
    for place in range(number):
        for turn in range(turns):
            here = place * turns + turn
            found.append((here, place * turns + (turn + 1) % turns))
            found.append((here, (place + 1) % number * turns + turn))
    return torch.tensor(found).sort(1).values.unique(dim=0)


def places(embedding: torch.Tensor) -> torch.Tensor:
    """Logits by the distance of embeddings: both corners are as likely."""
    return -torch.cdist(embedding, VIEWS).square()


def make(
    seed=0,
    poses=POSES,
    places=places,
    offsets=None,
    ground=None,
    place_key=None,
    block_within=None,
    **rules,
):
    ends = edges()
    known = NavigatorMap(
        num_waypoints=len(POSES),
        embeddings=VIEWS,
        prepared=VIEWS,
        edges=ends,
        edge_cost=(POSES[ends[:, 0], :2] - POSES[ends[:, 1], :2]).norm(dim=1) + 0.3,
        version=0,
    )
    given = {"lookahead": 12, "temperature": 0.2, "mask_noop_actions": True}
    return PoseNavigator(
        known,
        lambda views: views.flatten(1).float(),
        compare,
        NavigatorRules(tc_reach=0.0, **(given | {"block_after": None} | rules)),
        known=PoseMap(
            poses=poses,
            track=POSES[:, :2],
            effects=EFFECTS,
            places=places,
            offsets=offsets,
            ground=ground,
        ),
        belief=BeliefRules(),
        goal_reward=10.0,
        place_key=place_key,
        block_within=block_within,
        seed=seed,
    )


def reading(poses, goals, *, begins, paid=0.0) -> TensorDict:
    """What agents at these poses read; four views of each goal."""
    views = torch.tensor([look(*pose) for pose in poses])
    shown = [[look(*goal, turn) for turn in HEADINGS] for goal in goals]
    number = len(poses)
    return TensorDict(
        {
            PIXELS: views.reshape(number, 1, 1, -1),
            GOAL_VIEWS: torch.tensor(shown).reshape(number, 4, 1, 1, -1),
            PREVIOUS_REWARD: torch.full((number, 1), paid),
            IS_INIT: torch.full((number, 1), begins),
        },
        [number],
    )


def go(pose, action, closed=None):
    """Where the action leads: agents slide along walls."""
    x, y, heading = pose
    ahead, _, turn = EFFECTS[action].tolist()
    east, north = ahead * cos(radians(heading)), ahead * sin(radians(heading))
    x = x + east if _is_open(x + east, y, closed) else x
    y = y + north if _is_open(x, y + north, closed) else y
    return x, y, heading + turn


def _is_open(x, y, closed) -> bool:
    inside = closed and closed[0] < x < closed[1] and y < 5
    return is_free(x, y) and not inside


def walk(navigator, start, goal, decisions, closed=None):
    """Decisions until it is at the goal, and the last pose."""
    pose = start
    for number in range(decisions):
        data = navigator(reading([pose], [goal], begins=number == 0))
        pose = go(pose, int(data[ACTION]), closed)
        if abs(pose[0] - goal[0]) + abs(pose[1] - goal[1]) < 1.2:
            return number + 1, pose
    return None, pose


@pytest.mark.parametrize("goal", [(2.5, 9.1), (9.1, 13.5), (13.5, 4.7)])
def test_it_walks_to_the_goal_from_either_side(goal) -> None:
    for seed, start in enumerate([(6.9, 2.5, 10.0), (13.5, 9.1, 200.0)]):
        decisions, pose = walk(make(seed), start, goal, 120)
        # At most half of the way round, 22 steps, and turns at its corners.
        assert decisions is not None, (start, goal, pose)


def test_a_goal_is_where_most_of_its_views_are() -> None:
    data = reading([(6.9, 2.5, 0.0)], [(13.5, 9.1)], begins=True)
    data[GOAL_VIEWS][0, 2] = torch.tensor(look(2.5, 9.1, 90.0))
    navigator = make()
    navigator(data)
    # The mean of all four would be 2.75 to the west.
    assert (navigator._goal[0] - torch.tensor([13.5, 9.1])).norm() < 1.5


def test_of_two_corners_that_look_alike_it_knows_its_own() -> None:
    navigator, pose = make(), (6.9, 2.5, 180.0)
    # 5 steps to the corner at (2, 2), whose views are those of the one at (14, 14).
    for number in range(5):
        data = navigator(reading([pose], [(2.5, 9.1)], begins=number == 0))
        pose = go(pose, 0)
        navigator.took(torch.tensor([0]))
    place = POSES[int(data[PLACE])]
    assert (place[:2] - torch.tensor([2.5, 2.5])).norm() < 3


def test_an_edge_that_cannot_be_passed_is_walked_around() -> None:
    start, goal, closed = (2.5, 4.7, 270.0), (9.1, 2.5), (3.2, 8.0)
    decisions, _ = walk(make(), start, goal, 60, closed)
    assert decisions is None
    decisions, _ = walk(make(block_after=20), start, goal, 300, closed)
    # 40 steps round the other way, after 20 before the blockage.
    assert decisions is not None
    assert decisions > 50


def test_all_edges_through_what_cannot_be_passed_close_at_once() -> None:
    start, goal, closed = (2.5, 4.7, 270.0), (9.1, 2.5), (3.2, 8.0)
    navigator = make(block_after=20, block_within=1.75)
    decisions, _ = walk(navigator, start, goal, 150, closed)
    assert decisions is not None
    one, other = POSES[navigator.map.edges[navigator.plans.closed[0]]].unbind(1)
    # They lead through what is closed, along the one side of the ring that has it.
    assert len(one) > 4
    assert (one[:, 1] < 5).all()
    assert (other[:, 1] < 5).all()
    assert (torch.maximum(one[:, 0], other[:, 0]) > closed[0] - 1).all()
    assert navigator.plans.num_cuts.item() == 1


def test_what_it_tried_most_is_closed_and_not_what_it_tried_last() -> None:
    navigator = make(block_after=20, block_within=1.75)
    data = navigator(reading([(6.9, 2.5, 0.0)], [(2.5, 9.1)], begins=True))
    often, last = torch.tensor([9.1, 2.5]), torch.tensor([2.5, 6.9])
    navigator._tried[:] = often
    navigator._pose[0, :2] = navigator._aims[0] = last
    navigator.progress.watch = lambda place, cost: torch.ones_like(place, dtype=bool)
    navigator._give_up(data[PLACE].flatten())
    ends = POSES[navigator.map.edges[navigator.plans.closed[0]]][..., :2]
    # What passes within 1.75 steps begins or ends up to 2.2 steps further.
    assert len(ends) > 4
    assert (ends - often).norm(dim=2).max() < 1.75 + 2.2


def test_beside_a_place_without_a_path_it_takes_one_that_has_a_path() -> None:
    navigator, at = make(), ([(6.9, 2.5, 0.0)], [(2.5, 9.1)])
    place = int(navigator(reading(*at, begins=True))[PLACE])
    own = (navigator.map.edges == place).any(1).nonzero().flatten()
    navigator.plans.close_all(0, place, own)
    navigator.sampler.last_action = torch.tensor([2])
    data = navigator(reading(*at, begins=False))
    assert int(data[PLACE]) != place
    assert (POSES[int(data[PLACE]), :2] - POSES[place, :2]).norm() < 4
    # Nothing opened for it.
    assert navigator.plans.num_cuts.tolist() == [1]
    # Where nothing near has a path, the cut opens.
    navigator.plans.close_all(0, place, torch.arange(len(navigator.map.edges)))
    navigator(reading(*at, begins=False))
    assert not navigator.plans.closed.all()


def test_an_episode_of_one_agent_leaves_the_others_alone() -> None:
    navigator = make()
    two = [(6.9, 2.5, 0.0), (13.5, 9.1, 90.0)], [(2.5, 9.1), (2.5, 9.1)]
    navigator(reading(*two, begins=True))
    for _ in range(4):
        navigator(reading(*two, begins=False))
    data = reading([(6.9, 13.5, 0.0), two[0][1]], two[1], begins=False)
    data[IS_INIT][0] = True
    data = navigator(data)
    assert (
        POSES[data[PLACE].flatten()][:, 0] - torch.tensor([6.9, 13.5])
    ).abs().max() < 3
    # The second one's belief is what five views made of it.
    spread = navigator.belief.poses[1, :, :2].std(0).norm()
    assert spread < 2
    # A goal's reward says that an agent was put elsewhere, too.
    data = reading([two[0][0], two[0][0]], two[1], begins=False)
    data[PREVIOUS_REWARD][1] = 10.0
    data = navigator(data)
    assert abs(POSES[int(data[PLACE][1]), 0] - 6.9) < 3


def test_what_it_says_has_the_shapes_of_a_navigator() -> None:
    data = reading([(6.9, 2.5, 0.0)] * 6, [(2.5, 9.1)] * 6, begins=True).reshape(2, 3)
    data = make()(data)
    assert data[ACTION].shape == (2, 3)
    for key in (PLACE, PATH_COST, LOST):
        assert data[key].shape == (2, 3, 1)
    assert not data[LOST].any()


def test_a_seed_repeats_it() -> None:
    one, other = (walk(make(3), (6.9, 2.5, 10.0), (2.5, 9.1), 60) for _ in range(2))
    assert one == other


def test_an_agent_that_is_told_its_waypoint_believes_in_poses_around_it() -> None:
    # Its own place network would say that it is at the opposite corner.
    elsewhere, told = POSES.flip(0), ("privileged", "place")
    navigator = make(
        places=lambda views: -torch.cdist(views, VIEWS.flip(0)).square(),
        place_key=told,
    )
    data = reading([POSES[8].tolist()], [POSES[20, :2].tolist()], begins=True)
    found = navigator(data.set(told, torch.tensor([[8]])))
    assert found[PLACE].item() == 8
    assert (navigator._pose[0, :2] - POSES[8, :2]).norm() < 1
    assert (elsewhere[8, :2] - POSES[8, :2]).norm() > 3


def test_who_is_told_no_place_goes_by_its_view() -> None:
    # Two agents in one place, of which one is told where.
    told = ("privileged", "place")
    navigator = make(place_key=told)
    poses, goals = [POSES[8].tolist()] * 2, [POSES[20, :2].tolist()] * 2
    data = reading(poses, goals, begins=True)
    found = navigator(data.set(told, torch.tensor([[8], [-1]])))
    assert found[PLACE].flatten().tolist()[0] == 8
    away = (navigator._pose[:, :2] - POSES[8, :2]).norm(dim=1)
    assert away.tolist() == pytest.approx([0, 0], abs=1)


def test_it_acts_by_what_its_view_says_is_free() -> None:
    # A waypoint's pose, and the goal at the next corner, straight ahead or not.
    told, free = ("privileged", "place"), torch.full((1, 13, 12), 9.0)
    data = reading([POSES[8].tolist()], [POSES[20, :2].tolist()], begins=True)
    data = data.set(told, torch.tensor([[8]]))
    plain = make(place_key=told)
    plain(data)
    gap = plain._aims[0] - plain._pose[0, :2]
    bearing = torch.atan2(gap[1], gap[0]).rad2deg() - plain._pose[0, 2]
    bearing = (float(bearing) + 180) % 360 - 180
    # All is free but what lies on the side of the aim: it turns to the other one.
    side = BEARINGS > 0 if bearing > 0 else BEARINGS < 0
    walls = free.masked_fill(side.unsqueeze(1), -9.0)
    asked = []

    def ground(embedding: torch.Tensor) -> torch.Tensor:
        asked.append(embedding)
        return walls

    seeing = make(place_key=told, ground=ground)
    seeing(data)
    assert asked[0].shape == (1, VIEWS.shape[1])
    # The aim of the path is the same, and what is said of the actions is not.
    assert seeing._aims.equal(plain._aims)
    assert not seeing._free.equal(plain._free)
    nothing = make(place_key=told, ground=lambda embedding: -free)
    nothing(data)
    assert nothing._free.equal(plain._free)
    wrong = make(place_key=told, ground=lambda embedding: free[:, 0])
    with pytest.raises(
        ValueError, match=r"ground must return \[N, K, R\], got \[1, 12"
    ):
        wrong(data)


@pytest.mark.parametrize("kind", [PoseNavigator, PractisingNavigator])
def test_it_sees_with_its_map_s_networks(kind) -> None:
    plain = make()
    networks = {"embed": plain.embed, "compare": plain.compare}
    seeing = SimpleNamespace(
        **vars(plain.map), **networks, rules=MapRules(tc_threshold=0.9, tc_reach=0.4)
    )
    given = {"known": plain.known, "belief": plain.belief_rules}
    given["controller"] = lambda embedding, senses, free: free
    over = kind.over(seeing, **given)
    assert over.rules == NavigatorRules(tc_reach=0.4)
    over = kind.over(seeing, rules=plain.rules, **given)
    assert over.rules is plain.rules
    data = reading([(6.9, 2.5, 0.0)], [(2.5, 9.1)], begins=True)
    assert over(data)[PATH_COST].isfinite()


def test_a_map_without_poses_is_refused() -> None:
    some = POSES.clone()
    some[3] = torch.nan
    rule = (
        rf"all {len(POSES)} waypoints of the map must have poses, got {len(POSES) - 1}"
    )
    with pytest.raises(ValueError, match=rule):
        make(poses=some)


def test_agent_and_goal_are_where_offsets_say() -> None:
    # All views are a step to the east and two to the north of their waypoints.
    beside = torch.tensor([1.0, 2.0, 0.0])

    def offsets(embedding: torch.Tensor) -> torch.Tensor:
        return beside.expand(len(embedding), len(POSES), 3)

    data = reading([POSES[8].tolist()], [POSES[20, :2].tolist()], begins=True)
    plain, moved = make(), make(offsets=offsets)
    for navigator in (plain, moved):
        for _ in range(5):
            navigator(data.clone())
            data["is_init"] = torch.zeros(1, 1, dtype=torch.bool)
        data["is_init"] = torch.ones(1, 1, dtype=torch.bool)
    torch.testing.assert_close(moved._goal - plain._goal, beside[None, :2])
    away = moved._pose[0, :2] - plain._pose[0, :2]
    assert (away - beside[:2]).norm() < 1.0
    with pytest.raises(ValueError, match=r"offsets must return \[N, W, X\], got"):
        make(offsets=lambda embedding: torch.zeros(len(embedding), 2))(data)
