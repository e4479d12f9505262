import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import InitTracker, SerialEnv, TransformedEnv

from tests.fakes import MAZES, TINY, WORLD, FakeMaze
from toponav.keys import ACTION, BLOCKED, CELL, GOAL_CELL, HEADING, POSITION
from toponav.policies import FrontierExpert, PathFollower

CORRIDOR = torch.ones(1, 5, dtype=torch.bool)


def pose(column, heading, goal=None):
    """Return a pose in the middle of a corridor's cell."""
    data = TensorDict(
        {
            POSITION: torch.tensor([[column * 128 + 64.0, 64.0]]),
            HEADING: torch.tensor([[float(heading)]]),
            CELL: torch.tensor([[0, column]]),
        },
        batch_size=[1],
    )
    if goal is not None:
        data[GOAL_CELL] = torch.tensor([goal])
    return data


def slots_of(env):
    return list(env.slots.values())


def decisions_to_full_coverage(maze, *, num_envs, limit, **arguments):
    """Walk until every cell was visited; return the decisions, -1 if not reached."""
    env = FakeMaze(MAZES[maze], batch_size=[num_envs], max_decisions=10**6, **arguments)
    env.start_cells = env.mask.nonzero()
    expert = FrontierExpert(
        env.mask, world=WORLD, slot_cells=slots_of(env), init_key=None
    )
    data = env.reset()
    env.goal.fill_(-9)  # no goal: nobody is moved
    columns, need = env.mask.shape[1], int(env.mask.sum())
    seen = torch.zeros(num_envs, env.mask.numel(), dtype=torch.bool)
    decisions = torch.full((num_envs,), -1)
    for decision in range(limit + 1):
        row, column = data[CELL].unbind(-1)
        seen[torch.arange(num_envs), row * columns + column] = True
        decisions[(seen.sum(1) == need) & (decisions < 0)] = decision
        if (decisions >= 0).all():
            break
        data = env.step(expert(data))["next"]
    return decisions


@pytest.mark.parametrize(
    # The notes' expert needs 266, 358 and 330 on the engine; this one, which
    # rounds corners, 241, 311 and 309 here. A tenth is left for the start poses.
    ("maze", "mean"),
    [("maze1", 266), ("maze2", 342), ("maze3", 340)],
)
def test_frontier_expert_visits_every_cell_in_time(maze, mean):
    decisions = decisions_to_full_coverage(maze, num_envs=24, limit=600)
    assert (decisions >= 0).all()
    assert decisions.float().mean() < mean


def test_frontier_expert_goes_to_the_nearer_side_first():
    # Two cells to each side; it looks west, and turning round costs nine decisions.
    for heading in (180.0, 0.0):
        expert = FrontierExpert(CORRIDOR, world=WORLD, init_key=None)
        assert expert(pose(2, heading))[ACTION].item() == 0


def test_frontier_expert_turns_to_what_is_left():
    expert = FrontierExpert(CORRIDOR, world=WORLD, init_key=None)
    for column in (2, 3, 4):
        action = expert(pose(column, 0.0))[ACTION].item()
    assert action in (2, 3)  # the west is left, and it looks east


def test_frontier_expert_wanders_when_everything_is_visited():
    expert = FrontierExpert(CORRIDOR[:, :1], world=WORLD, init_key=None, seed=0)
    actions = [expert(pose(0, 0.0))[ACTION].item() for _ in range(60)]
    assert set(actions) == set(range(6))


def test_frontier_expert_forgets_at_an_episodes_start():
    expert = FrontierExpert(CORRIDOR, world=WORLD)
    two = torch.cat([pose(3, 0.0), pose(3, 0.0)])
    expert(two.set("is_init", torch.ones(2, 1, dtype=torch.bool)))
    again = torch.cat([pose(2, 0.0), pose(2, 0.0)])
    expert(again.set("is_init", torch.tensor([[True], [False]])))
    assert expert.visited.sum(1).tolist() == [1, 2]


def test_frontier_expert_without_init_key_in_the_data_says_so():
    with pytest.raises(KeyError, match="is_init"):
        FrontierExpert(CORRIDOR, world=WORLD)(pose(2, 0.0))


def test_frontier_expert_leaves_out_what_a_closed_slot_cuts_off():
    expert = FrontierExpert(
        CORRIDOR, world=WORLD, slot_cells=[(0, 3)], init_key=None, seed=0
    )
    closed = {BLOCKED: torch.tensor([[True]])}
    for column in (2, 1, 0):
        expert(pose(column, 180.0).update(TensorDict(closed, [1])))
    actions = {
        expert(pose(0, 180.0).update(TensorDict(closed, [1])))[ACTION].item()
        for _ in range(60)
    }
    assert actions == set(range(6))  # nothing left to visit: it wanders
    opened = pose(0, 0.0).update(TensorDict({BLOCKED: torch.tensor([[False]])}, [1]))
    assert expert(opened)[ACTION].item() == 0  # and goes on once the slot opens


@pytest.mark.parametrize(
    # The notes' path follower reaches 137, 161 and 124 goals in 5000 decisions.
    ("maze", "goals"),
    [("maze1", 137), ("maze2", 161), ("maze3", 124)],
)
def test_path_follower_reaches_many_goals(maze, goals):
    env = FakeMaze(MAZES[maze], batch_size=[16], max_decisions=10**6)
    expert = PathFollower(env.mask, world=WORLD, slot_cells=slots_of(env))
    data = env.rollout(250, expert, break_when_any_done=False)
    per_5000 = (data["next", "reward"] > 0).float().mean().item() * 5000
    assert per_5000 > goals * 0.9


@pytest.mark.parametrize(
    ("heading", "actions"),
    [(0, {0}), (90, {3}), (-90, {2}), (180, {2, 3}), (30, {5}), (-30, {4})],
)
def test_path_follower_turns_towards_the_next_cell(heading, actions):
    data = PathFollower(CORRIDOR, world=WORLD)(pose(1, heading, goal=(0, 4)))
    assert data[ACTION].item() in actions


def test_path_follower_takes_the_detour_once_the_slot_closes():
    env = FakeMaze(TINY, batch_size=[2], max_decisions=10**6)
    env.blocked[1] = True
    expert = PathFollower(env.mask, world=WORLD, slot_cells=slots_of(env))
    env.reset()
    env.position = env.centre(torch.tensor([[1, 2], [1, 2]]))
    env.heading = torch.zeros(2)
    env.goal = torch.tensor([[2, 3], [2, 3]])
    data = env._observe(torch.zeros(2, dtype=torch.bool))
    cells = []
    for _ in range(6):
        data = env.step(expert(data))["next"]
        cells.append(data[CELL].clone())
    paths = torch.stack(cells, 1).tolist()
    assert [1, 3] in paths[0]
    assert [1, 3] not in paths[1]


def test_path_follower_without_a_goal_wanders():
    expert = PathFollower(CORRIDOR, world=WORLD, seed=0)
    actions = [expert(pose(1, 0, goal=(-1, -1)))[ACTION].item() for _ in range(60)]
    assert set(actions) == set(range(6))


@pytest.mark.parametrize("make", ["alone", "batched", "nested"])
def test_experts_follow_the_shape_of_the_data(make):
    env = {
        "alone": lambda: FakeMaze(MAZES["maze3"]),
        "batched": lambda: FakeMaze(MAZES["maze3"], batch_size=[3]),
        "nested": lambda: SerialEnv(
            2, lambda: FakeMaze(MAZES["maze3"], batch_size=[3])
        ),
    }[make]()
    mask = FakeMaze(MAZES["maze3"]).mask
    env = TransformedEnv(env, InitTracker())
    for expert in (
        PathFollower(mask, world=WORLD),
        FrontierExpert(mask, world=WORLD),
    ):
        data = env.rollout(30, expert, break_when_any_done=False)
        assert data[ACTION].shape == (*env.batch_size, 30)
        assert data[ACTION].dtype is torch.int64
