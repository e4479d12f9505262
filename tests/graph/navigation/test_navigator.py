import copy

import pytest
import torch
from hypothesis import given, settings, strategies as st
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import (
    Compose,
    InitTracker,
    RenameTransform,
    SerialEnv,
    TransformedEnv,
)
from torchrl.envs.utils import check_env_specs

from tests.graph.grid_world import (
    GOAL,
    RING,
    START,
    UPPER,
    GridMap,
    GridWorld,
    as_task,
    as_view,
    compare,
    embed,
    locomotion,
    make_navigator,
)
from toponav.graph import MapRules, Navigator, NavigatorRules, TopologicalMap
from toponav.keys import (
    ACTION,
    CUT_FROM,
    CUT_TO,
    ENV_ID,
    GOAL_NODE,
    GOAL_VIEWS,
    IS_INIT,
    LOST,
    NUM_CUTS,
    PATH_COST,
    PIXELS,
    PLACE,
    POSITION,
    PREVIOUS_REWARD,
    TARGET,
)

# The upper way is 4 squares long, the lower one 3 + 4 + 3 = 10.
SHORT, LONG = 4, 10


@pytest.fixture
def grid():
    return GridMap(RING)


def walk(world, navigator, decisions, **arguments):
    return as_task(world).rollout(
        decisions, navigator, break_when_any_done=False, **arguments
    )


def goals(data):
    return int((data["next", "reward"] > 0).sum())


def view_of(cell, *, goal=GOAL, paid=0.0, begins=True):
    """What a navigator reads at a square, for one env."""
    return TensorDict(
        {
            PIXELS: as_view(torch.tensor([cell])),
            GOAL_VIEWS: as_view(torch.tensor([[goal]])),
            PREVIOUS_REWARD: torch.tensor([[paid]]),
            IS_INIT: torch.tensor([[begins]]),
        },
        [1],
    )


def test_the_world_keeps_its_specs():
    check_env_specs(as_task(GridWorld(batch_size=[2], episode_length=4)))


def test_it_walks_the_shortest_way_again_and_again(grid):
    data = walk(GridWorld(), make_navigator(grid), 3 * SHORT)
    assert goals(data) == 3
    assert data["next", "reward"].flatten().nonzero().flatten().tolist() == [3, 7, 11]
    assert data[PATH_COST].flatten().tolist() == [4.0, 3.0, 2.0, 1.0] * 3


def test_it_says_what_it_decided(grid):
    decided = make_navigator(grid)(view_of(START))
    assert decided[PLACE].item() == grid.number(START)
    assert decided[TARGET].item() == grid.number((1, 2))
    assert decided[GOAL_NODE].item() == grid.number(GOAL)
    assert (decided[NUM_CUTS].item(), decided[LOST].item()) == (0, False)
    assert (decided[CUT_FROM].item(), decided[CUT_TO].item()) == (-1, -1)
    for key in (PLACE, TARGET, GOAL_NODE, PATH_COST, NUM_CUTS, LOST):
        assert decided[key].shape == (1, 1)
    assert decided[ACTION].shape == (1,)


def test_it_aims_at_the_farthest_waypoint_that_is_reachable(grid):
    # Two squares away is 1 / (1 + 4) = 0.2, three away 1 / (1 + 9) = 0.1.
    aims = {0.4: (1, 2), 0.15: (1, 3), 0.09: (1, 4)}
    for reach, cell in aims.items():
        decided = make_navigator(grid, tc_reach=reach)(view_of(START))
        assert decided[TARGET].item() == grid.number(cell)
    decided = make_navigator(grid, tc_reach=0.09, lookahead=2)(view_of(START))
    assert decided[TARGET].item() == grid.number((1, 3))


def test_at_the_goals_waypoint_it_walks_to_the_goal_view(grid):
    # The goal view lies between two squares; the nearer one stands for it.
    navigator = make_navigator(grid)
    data = view_of((4, 3), goal=(4, 3))
    data[GOAL_VIEWS] = data[GOAL_VIEWS].float() + torch.tensor([0.0, 0.25, 0.0])
    decided = navigator(data)
    assert decided[TARGET].item() == -1
    assert decided[PATH_COST].item() == 0.0
    assert decided[ACTION].item() == 3  # a quarter of a square to the east


def test_a_blockage_is_closed_after_so_many_decisions_and_walked_around(grid):
    world = GridWorld()
    world.closed = {UPPER}
    data = walk(world, make_navigator(grid, block_after=5), 5 + 1 + LONG)
    cut = (data[CUT_FROM].flatten() >= 0).nonzero().flatten().tolist()
    # What is left of the way: 4, 3, 3, 3, 3. The last two are not below the first two.
    assert cut == [4]
    assert data[CUT_FROM][4].item() == grid.number((1, 2))
    assert data[CUT_TO][4].item() == grid.number(UPPER)
    assert goals(data) == 1
    assert data[NUM_CUTS].flatten().tolist() == [0] * 4 + [1] * (len(data) - 4)
    # From (1, 2) back to the corner and around: 1 + 10, and it planned that at once.
    assert data[PATH_COST][4].item() == LONG + 1


def test_the_first_edge_of_a_path_can_be_the_one_that_is_closed(grid):
    world = GridWorld(start=(1, 2))
    world.closed = {UPPER}
    data = walk(world, make_navigator(grid, block_after=5), 30)
    assert data[CUT_FROM][4].item() == grid.number((1, 2))
    # 11 squares around, from decision 4 on, and once more from the start.
    assert data["next", "reward"].flatten().nonzero().flatten().tolist() == [14, 25]


def test_without_giving_up_it_stays_before_the_blockage(grid):
    world = GridWorld()
    world.closed = {UPPER}
    data = walk(world, make_navigator(grid, block_after=None), 80)
    assert goals(data) == 0
    assert not data[NUM_CUTS].any()


def test_cuts_stay_over_a_reached_goal_and_end_with_the_episode(grid):
    world = GridWorld(episode_length=50)
    world.closed = {UPPER}
    data = walk(world, make_navigator(grid, block_after=5), 100)
    cuts = (data[CUT_FROM] >= 0).flatten().nonzero().flatten().tolist()
    # After the cut at 4 the goal is reached three times more without another cut.
    assert cuts == [4, 54]
    assert goals(data[:50]) == 4


def test_cuts_fade(grid):
    world = GridWorld()
    world.closed = {UPPER}
    data = walk(world, make_navigator(grid, block_after=5, fade_after=20), 60)
    open_again = (data[NUM_CUTS].flatten() == 0).nonzero().flatten().tolist()
    # Made in the 5th decision, number 4, and open again in the one numbered 24.
    assert open_again[4] == 24


def test_when_nothing_is_left_the_newest_cut_that_failed_least_opens_again():
    # Three ways of 4, 8 and 12 squares, each closed in its middle.
    upper, middle, lower = slots = (1, 3), (3, 3), (5, 3)
    rows = (*RING[:3], "#.....#", *RING[3:])
    grid, world = GridMap(rows), GridWorld(rows)
    world.closed = set(slots)
    env = as_task(world)
    navigator = make_navigator(grid, block_after=5)
    data = env.rollout(120, navigator, break_when_any_done=False)
    assert goals(data) == 0
    ends = data[CUT_TO].flatten()
    tried = [tuple(cell) for cell in grid.cells[ends[ends >= 0]].tolist()]
    # The third cut leaves no path, and opens again as the newest. When it has failed
    # once more, the newer one of the two others opens, and then the first. Now all have
    # failed twice, and the newest opens again.
    assert tried[:3] == [upper, middle, lower]
    assert tried[3:7] == [lower, middle, upper, upper]
    # So it goes on, and is never without a plan.
    assert set(tried[7:]) == set(slots)
    assert data[PATH_COST].isfinite().all()
    assert data[NUM_CUTS].max() == 2
    world.closed = {middle, lower}
    later = env.rollout(
        60,
        navigator,
        auto_reset=False,
        tensordict=data[-1]["next"].clone(),
        break_when_any_done=False,
    )
    assert goals(later) >= 1


def test_it_recovers_when_slots_open_and_close_in_mid_episode(grid):
    world = GridWorld()
    env, navigator = as_task(world), make_navigator(grid, block_after=4)
    data = env.reset()
    reached = []
    for decision in range(240):
        # Never both: the world stays in one piece.
        world.closed = {UPPER} if (decision // 40) % 2 else {(4, 3)}
        data = env.step(navigator(data))
        reached.append(data["next", "reward"].item() > 0)
        data = data["next"].exclude("reward")
        data[IS_INIT] = torch.tensor([False])
    assert all(any(reached[part : part + 40]) for part in range(0, 240, 40))


@pytest.mark.slow
@settings(max_examples=15)
@given(st.lists(st.sets(st.sampled_from([UPPER, (2, 1), (4, 3), (3, 5)])), max_size=8))
def test_no_closing_and_opening_breaks_it(closings):
    world = GridWorld(batch_size=[2])
    navigator = make_navigator(GridMap(RING), block_after=3)
    env = as_task(world)
    data = env.reset()
    for closed in closings:
        world.closed = closed
        data = env.rollout(
            7,
            navigator,
            auto_reset=False,
            tensordict=data,
            break_when_any_done=False,
        )[:, -1]["next"].clone()
        world.closed = set()
    # And then it finds its way: 10 squares, and whatever was closed opens again.
    data = env.rollout(
        90, navigator, auto_reset=False, tensordict=data, break_when_any_done=False
    )
    assert ((data["next", "reward"] > 0).sum(1) > 0).all()


@pytest.mark.parametrize(("follow", "second"), [(6, (1, 2)), (0, (2, 2))])
def test_it_looks_along_its_path_first(follow, second):
    # The way from the corner to the goal is the upper row. (1.6, 2) is more like the
    # lower one, 1 / (1 + 0.4^2) = 0.86 against 1 / (1 + 0.6^2) = 0.74.
    field = GridMap(("#####", "#...#", "#...#", "#####"))
    navigator = make_navigator(field, follow=follow)
    goal = (1, 3)
    navigator(view_of((1, 1), goal=goal))
    navigator.embed = lambda views: torch.tensor([[1.6, 2.0]])
    decided = navigator(view_of((1, 2), goal=goal, begins=False))
    assert decided[PLACE].item() == field.number(second)


def test_one_hot_actions_are_the_same_ones(grid):
    decided = make_navigator(grid)(view_of(START))
    navigator = make_navigator(grid)
    navigator.one_hot = True
    one_hot = navigator(view_of(START))[ACTION]
    assert one_hot.shape == (1, 4)
    assert one_hot.sum() == 1
    assert one_hot.argmax(-1).tolist() == decided[ACTION].tolist()


def test_what_is_missing_is_named(grid):
    with pytest.raises(KeyError, match="must have 'goal_views': add GoalViews, got"):
        make_navigator(grid)(view_of(START).exclude(GOAL_VIEWS))


def test_who_gives_up_looks_beside_its_path(grid):
    # It stands at (1, 2) and (1, 3) is closed. What it believes is (1, 1), half alike,
    # from where a way leads on; once it gave up on that it finds that it is at (1, 2).
    grid.edges = torch.cat([grid.edges, torch.tensor([[0, grid.number(UPPER)]])])
    grid.edge_cost = torch.ones(len(grid.edges))
    world = GridWorld(start=(1, 2))
    world.closed = {UPPER}
    data = walk(world, make_navigator(grid, block_after=5), 30)
    place, cut = data[PLACE].flatten(), data[CUT_FROM].flatten() >= 0
    second = cut.nonzero().flatten()[1]
    assert grid.cells[place[second]].tolist() == [1, 1]
    assert data[PIXELS][second].flatten()[:2].tolist() == [1, 2]
    assert grid.cells[place[second + 1]].tolist() != [1, 1]


def test_the_second_cut_takes_what_lies_beside_the_path(grid):
    # Two more edges over the closed square, from the corner and from the one below it.
    below, corner, before, closed = (
        grid.number(cell) for cell in ((2, 1), (1, 1), (1, 2), UPPER)
    )
    more = torch.tensor([[corner, closed], [below, closed]])
    grid.edges = torch.cat([grid.edges, more])
    grid.edge_cost = torch.ones(len(grid.edges))
    world = GridWorld(start=(1, 2))
    world.closed = {UPPER}
    data = walk(world, make_navigator(grid, block_after=5), 60)
    # The first cut takes the edge that failed, the second those of all three.
    cut_from = [number for number in data[CUT_FROM].flatten().tolist() if number >= 0]
    assert cut_from == [before, corner]
    assert goals(data) >= 3


def test_by_edges_it_closes_the_next_one_of_its_path_and_no_other(grid):
    # As above, two more edges over the closed square.
    below, corner, before, closed = (
        grid.number(cell) for cell in ((2, 1), (1, 1), (1, 2), UPPER)
    )
    grid.edges = torch.cat(
        [grid.edges, torch.tensor([[corner, closed], [below, closed]])]
    )
    grid.edge_cost = torch.ones(len(grid.edges))
    world = GridWorld(start=(1, 2))
    world.closed = {UPPER}
    navigator = make_navigator(grid, block_on="edge", block_after=5)
    data = walk(world, navigator, 60)
    cuts = (data[CUT_FROM].flatten() >= 0).nonzero().flatten().tolist()
    # Five decisions at (1, 2), and five at what it takes for the corner. Then the plan
    # leads over the third edge, from (2, 1), where it is from decision 12 on.
    assert cuts == [4, 9, 16]
    assert data[CUT_FROM].flatten()[cuts].tolist() == [before, corner, below]
    assert data[CUT_TO].flatten()[cuts].tolist() == [closed] * 3
    # Each cut is one edge, for the rest of the episode.
    assert navigator.plans.closed.sum() == 3
    assert goals(data) >= 3


def test_by_edges_patience_begins_again_with_a_step_nearer(grid):
    world = GridWorld()
    world.closed = {UPPER}
    navigator = make_navigator(grid, block_on="edge", block_after=5)
    data = walk(world, navigator, 6 + 1 + LONG)
    # What is left of the way: 4, and then 3 for five decisions.
    cut = (data[CUT_FROM].flatten() >= 0).nonzero().flatten().tolist()
    assert cut == [5]
    assert (data[CUT_FROM][5].item(), data[CUT_TO][5].item()) == (
        grid.number((1, 2)),
        grid.number(UPPER),
    )
    assert goals(data) == 1


def test_a_reached_goal_is_noticed_by_the_reward_alone(grid):
    # A place far away is not looked for near the last one unless the goal paid.
    ends = ((4, 5), (1, 2))
    for paid, expected in ((0.0, grid.number((1, 2))), (10.0, grid.number((1, 2)))):
        navigator = make_navigator(grid, hops=1, follow=0, tc_reach=0.1)
        navigator(view_of(ends[0], goal=(4, 1)))
        decided = navigator(view_of(ends[1], goal=(4, 1), paid=paid, begins=False))
        near = decided[PLACE].item()
        # (3, 5) is 1 / (1 + 4 + 9) from (1, 2), below tc_reach: it looks everywhere.
        assert near == expected
    navigator = make_navigator(grid, hops=1, follow=0, tc_reach=0.05)
    navigator(view_of(ends[0], goal=(4, 1)))
    stays = navigator(view_of(ends[1], goal=(4, 1), begins=False))
    assert stays[PLACE].item() in {grid.number(cell) for cell in ((3, 5), (4, 4))}
    moved = navigator(view_of(ends[1], goal=(4, 1), paid=10.0, begins=False))
    assert moved[PLACE].item() == grid.number(ends[1])


def test_a_goal_waypoint_that_does_not_deliver_is_dropped_for_the_episode(grid):
    # The first view shows (4, 1), which is nearer and wrong, the second the goal.
    world = GridWorld(goal_views=((4, 1), GOAL), start=(3, 1), episode_length=100)
    data = walk(world, make_navigator(grid, goal_patience=6), 100)
    wrong = data[PLACE].flatten() == grid.number((4, 1))
    # One step there; all actions are alike to it where the view is, so that it goes
    # north and comes back, and takes the square to the north, 1 / 2 alike, for the
    # waypoint; after six decisions there, never again.
    assert wrong.nonzero().flatten().tolist() == [1, 2, 3, 4, 5, 6]
    # Back at the start after six decisions, it is six squares from the goal: 94 / 6.
    assert goals(data) == 15


def test_a_farther_goal_is_no_lack_of_progress(grid):
    # As above; what was left of the way to the wrong goal was 1, and is then 7.
    world = GridWorld(goal_views=((4, 1), GOAL), start=(3, 1), episode_length=100)
    data = walk(world, make_navigator(grid, goal_patience=6, block_after=8), 30)
    assert goals(data) >= 2
    assert not (data[CUT_FROM] >= 0).any()


def test_when_all_goal_waypoints_are_dropped_the_first_comes_back(grid):
    world = GridWorld(goal_views=((4, 1), (4, 5)), start=(3, 1))
    data = walk(world, make_navigator(grid, goal_patience=6), 60)
    first, second = (
        (data[PLACE].flatten() == grid.number(cell)).nonzero().flatten()
        for cell in ((4, 1), (4, 5))
    )
    assert first[0] < second[0] < first[-1]


def test_the_lost_act_at_random_and_then_look_again(grid):
    navigator = make_navigator(grid, lost_for=3)
    for decision, cell in enumerate([(200, 200), (200, 200), START]):
        decided = navigator(view_of(cell, begins=not decision))
        assert decided[LOST].item()
        assert decided[PLACE].item() == decided[TARGET].item() == -1
        assert decided[PATH_COST].isinf()
        assert 0 <= decided[ACTION].item() < 4
    # After three random actions it looks again.
    assert not navigator(view_of(START, begins=False))[LOST].item()
    actions = set()
    for _ in range(40):
        actions.add(navigator(view_of((200, 200), begins=True))[ACTION].item())
    assert actions == {0, 1, 2, 3}
    found = [navigator(view_of(START, begins=begins)) for begins in (True, False)]
    assert not any(decided[LOST].item() for decided in found)


def test_envs_of_a_batch_do_not_touch_each_other(grid):
    def run(env):
        data = env.rollout(
            60, make_navigator(grid, block_after=5), break_when_any_done=False
        )
        return data[ACTION]

    def world(length, *closed):
        made = GridWorld(episode_length=length)
        made.closed = set(closed)
        return as_task(made)

    # Episodes that end at different times, with and without a blockage.
    kinds = [(17, UPPER), (200,), (23, (4, 3))]
    alone = torch.stack([run(world(*kind)) for kind in kinds])
    together = run(SerialEnv(3, [lambda k=kind: world(*k) for kind in kinds]))
    assert torch.equal(alone, together)


def test_privileged_entries_change_nothing(grid):
    world = GridWorld(batch_size=[3])
    world.closed = {UPPER}
    first, second = (
        make_navigator(grid, temperature=1.0, block_after=6, seed=4) for _ in "12"
    )
    env = as_task(world)
    data, generator = env.reset(), torch.Generator().manual_seed(0)
    for _ in range(80):
        lied = data.clone()
        lied[POSITION] = 1e6 * torch.randn(3, 2, generator=generator)
        decided = first(data)
        assert torch.equal(second(lied)[ACTION], decided[ACTION])
        assert not any("privileged" in str(key) for key in first.in_keys)
        _, data = env.step_and_maybe_reset(decided)


def test_a_frame_without_ground_truth_gives_the_same_actions(grid):
    data = GridWorld(batch_size=[3])
    data = as_task(data).rollout(40, break_when_any_done=False)
    bare, scrambled = data.exclude("privileged", ("next", "privileged")), data.clone()
    scrambled[POSITION] = 1e6 * torch.randn(3, 40, 2)
    actions = []
    for frames in (bare, scrambled):
        navigator = make_navigator(grid, temperature=1.0, seed=4)
        actions += [torch.stack([navigator(one)[ACTION] for one in frames.unbind(1)])]
    assert torch.equal(*actions)


def test_it_reads_its_in_keys_and_writes_its_out_keys_alone(grid):
    navigator = make_navigator(grid)
    data = view_of(START)
    assert set(data.keys(True, True)) == set(navigator.in_keys)
    for key in navigator.in_keys:
        with pytest.raises(KeyError, match=str(key)):
            make_navigator(grid)(data.exclude(key))
    before = data.clone()
    after = navigator(data)
    added = set(after.keys(True, True)) - set(before.keys(True, True))
    assert added == set(navigator.out_keys)
    assert (after.select(*navigator.in_keys) == before).all()


def test_keys_can_be_others_and_a_world_without_goals_needs_no_reward(grid):
    world = TransformedEnv(
        GridWorld(), Compose(RenameTransform(["pixels"], ["small"]), InitTracker())
    )
    navigator = make_navigator(
        grid, goal_reward=None, in_keys=["small", GOAL_VIEWS, IS_INIT]
    )
    data = world.rollout(SHORT, navigator)
    assert goals(data) == 1
    assert PREVIOUS_REWARD not in data


def test_it_walks_over_a_map_of_what_a_rollout_saw():
    env = as_task(GridWorld(batch_size=[4], episode_length=60))
    env.set_seed(0)
    torch.manual_seed(0)
    batch = env.rollout(300, break_when_any_done=False)
    batch[ENV_ID] = torch.arange(4).reshape(4, 1, 1).expand(4, 300, 1)
    rules = MapRules(
        tc_threshold=0.9, tc_reach=0.4, edges="time", window=0, search_window=0
    )
    scrambled = batch.clone()
    scrambled[POSITION] = torch.randn(4, 300, 2)
    maps = []
    for data in (batch, batch.exclude("privileged"), scrambled):
        maps.append(TopologicalMap(embed, compare, rules, goal_reward=10.0))
        maps[-1].set_keys(views=PIXELS)
        maps[-1].extend(data)
    states = [one.state_dict() for one in maps]
    for name in ("embeddings", "edges", "traversals"):
        assert all(torch.equal(states[0][name], state[name]) for state in states)
    # The goal itself is never seen: who reaches it is at the start.
    assert maps[0].num_waypoints == len(GridMap(RING).cells) - 1
    walked = walk(GridWorld(), make_navigator(maps[0]), 3 * SHORT)
    assert goals(walked) == 3


def test_it_sees_with_its_map_s_networks():
    env = as_task(GridWorld(batch_size=[4], episode_length=300))
    torch.manual_seed(0)
    rules = MapRules(
        tc_threshold=0.9, tc_reach=0.4, edges="time", window=0, search_window=0
    )
    known = TopologicalMap(embed, compare, rules, goal_reward=10.0)
    known.set_keys(views=PIXELS)
    for episode in env.rollout(300):
        known.add_episode(episode)
    over = Navigator.over(known, locomotion, goal_reward=10.0, one_hot=True)
    assert over.rules == NavigatorRules(tc_reach=0.4)
    assert (over.goal_reward, over.one_hot) == (10.0, True)
    rules = NavigatorRules(tc_reach=0.4, temperature=0.0)
    over = Navigator.over(known, locomotion, goal_reward=10.0, rules=rules)
    plain = Navigator(known, embed, compare, locomotion, rules, goal_reward=10.0)
    walks = [walk(GridWorld(), one, 3 * SHORT) for one in (over, plain)]
    assert torch.equal(walks[0][ACTION], walks[1][ACTION])
    assert goals(walks[0]) > 0


@pytest.mark.parametrize("one_hot", [False, True])
def test_it_goes_by_what_was_done_in_place_of_its_actions(grid, one_hot):
    navigator = make_navigator(grid, mask_noop_actions=True)
    navigator.one_hot = one_hot
    west, east = torch.eye(4).long()[2:] if one_hot else torch.tensor([2, 3])
    data = as_task(GridWorld()).reset()
    assert torch.equal(navigator(data)[ACTION], east)
    # It ran into the wall in the west, so that this is what is not done again.
    navigator.took(west)
    data[IS_INIT] = torch.tensor([False])
    assert torch.equal(navigator(data)[ACTION], east)


@pytest.mark.parametrize("shape", [(), (2,), (2, 3)])
def test_it_takes_any_batch_shape(grid, shape):
    data = walk(GridWorld(batch_size=shape), make_navigator(grid), 8)
    assert data[ACTION].shape == (*shape, 8)
    assert data[PLACE].shape == (*shape, 8, 1)
    assert ((data["next", "reward"] > 0).sum(-2) == 2).all()


def test_it_runs_under_a_collector(grid):
    collector = Collector(
        lambda: as_task(GridWorld(batch_size=[2], episode_length=9)),
        make_navigator(grid),
        frames_per_batch=20,
        total_frames=60,
        auto_register_policy_transforms=False,
    )
    try:
        batches = [batch.clone() for batch in collector]
    finally:
        collector.shutdown()
    data = torch.cat(batches, 1)
    assert data.shape == (2, 30)
    # Nine decisions are two goals of four and a rest; 30 are three such episodes.
    assert (data["next", "reward"] > 0).sum(1).flatten().tolist() == [6, 6]
    assert data[PATH_COST][:, ::9].eq(SHORT).all()


def test_a_map_that_changed_is_planned_on_again(grid):
    navigator = make_navigator(grid)
    navigator(view_of(START))
    # The upper way is gone from the map: the lower one is left.
    keep = (grid.edges != grid.number(UPPER)).all(1)
    grid.edges, grid.edge_cost = grid.edges[keep], grid.edge_cost[keep]
    grid.version = 1
    decided = navigator(view_of(START, begins=False))
    assert decided[PATH_COST].item() == LONG


def test_a_place_with_no_way_to_the_goal_counts_as_lost(grid):
    grid.edges, grid.edge_cost = grid.edges[:0], grid.edge_cost[:0]
    navigator = make_navigator(grid)
    assert navigator(view_of(START))[LOST].item()
    assert not navigator(view_of(GOAL))[LOST].item()


def test_a_copy_goes_its_own_way(grid):
    navigator = make_navigator(grid, block_after=5)
    world = GridWorld()
    world.closed = {UPPER}
    walk(world, navigator, 10)
    copied = copy.deepcopy(navigator)
    assert copied(view_of(START, begins=False))[NUM_CUTS].item() == 1
    navigator.plans.open_all(torch.tensor([True]))
    assert copied(view_of(START, begins=False))[NUM_CUTS].item() == 1


def test_an_action_that_changes_nothing_is_not_drawn_again(grid):
    # At the closed square it walks east in vain; the other three actions are left.
    world = GridWorld(start=(1, 2))
    world.closed = {UPPER}
    navigator = make_navigator(
        grid, temperature=0.1, block_after=None, mask_noop_actions=True
    )
    data = walk(world, navigator, 100)
    at = data[PIXELS].flatten(1)
    stays = (at[1:] == at[:-1]).all(1)
    in_vain = data[ACTION][:-1]
    # No action that left the view as it was is followed by itself.
    again = stays[:-1] & (in_vain[1:] == in_vain[:-1])
    assert stays.any()
    assert not again.any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tc_reach": 1.0}, r"tc_reach must be in \[0, 1\), got 1"),
        ({"hops": 0}, "hops must be at least 1, got 0"),
        ({"shortlist": 0}, "shortlist must be at least 1, got 0"),
        ({"follow": -1}, "follow must be at least 0, got -1"),
        ({"lookahead": 0}, "lookahead must be at least 1, got 0"),
        ({"lost_for": 0}, "lost_for must be at least 1, got 0"),
        ({"temperature": -1.0}, "temperature must be at least 0, got -1"),
        ({"block_on": "way"}, r"block_on must be one of \('goal', 'edge'\), got 'way'"),
        ({"block_after": 1}, "block_after must be at least 2, got 1"),
        ({"fade_after": 0}, "fade_after must be at least 1, got 0"),
        ({"goal_patience": 0}, "goal_patience must be at least 1, got 0"),
        ({"in_keys": ["pixels"]}, "in_keys must be 4, got"),
    ],
)
def test_arguments_out_of_range_are_refused(grid, arguments, message):
    with pytest.raises(ValueError, match=message):
        make_navigator(grid, **arguments)


def test_an_empty_map_is_refused():
    with pytest.raises(ValueError, match="got an empty map"):
        make_navigator(GridMap(("###",)))
