import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

from tests.checks import check_transform
from tests.fakes import FakeMaze
from toponav.modules import ActorCritic
from toponav.transforms import (
    CountReward,
    IntrinsicReward,
    TemporalDistanceReward,
    WaypointMemory,
    make_novelty_reward,
    make_policy_inputs,
)


class Pixels:
    """Embeds a view by its first pixel; what is prepared is ten times as large."""

    def embed(self, views):
        return views[..., 0, 0, :].float() / 255

    def prepare_memory(self, memory):
        return 10 * memory

    def compare_prepared(self, one, prepared):
        return (-4 * (one.unsqueeze(-2) - prepared / 10).norm(dim=-1)).exp()


def make_maze(batch_size):
    return FakeMaze(batch_size=batch_size, max_decisions=6)


def make_policy(**options):
    return ActorCritic(
        num_actions=6, embedding_dim=3, code_dim=4, hidden_dim=4, **options
    )


def make_all():
    reward = make_novelty_reward(Pixels(), 0.8, capacity=5)
    return Compose(*reward, *make_policy_inputs(make_policy()))


def rewards_of(*transforms):
    maze = FakeMaze(batch_size=[3], max_decisions=20)
    env = TransformedEnv(maze, Compose(*transforms))
    env.set_seed(0)
    torch.manual_seed(0)
    walk = env.rollout(50, break_when_any_done=False)["next"]
    return walk.select("intrinsic_reward", "count_reward", "waypoint", "embedding")


def test_the_reward_is_that_of_its_parts():
    network = Pixels()
    memory = WaypointMemory(
        network.embed,
        network.compare_prepared,
        prepare=network.prepare_memory,
        threshold=0.8,
        persistence=2,
    )
    parts = [memory, CountReward(0.3), TemporalDistanceReward(0.7), IntrinsicReward()]
    whole = make_novelty_reward(network, 0.8, alpha=0.3, persistence=2)
    found, expected = rewards_of(*whole), rewards_of(*parts)
    assert bool((found == expected).all())
    assert found["intrinsic_reward"].unique().numel() > 3


def test_specs_hold_under_every_nesting():
    check_transform(make_maze, make_all)


def test_a_policy_has_all_that_it_reads():
    policy = make_policy()
    steps = [*make_novelty_reward(Pixels(), 0.8), *make_policy_inputs(policy)]
    env = TransformedEnv(FakeMaze(batch_size=[2], max_decisions=5), Compose(*steps))
    with torch.no_grad():
        walk = env.rollout(12, policy, break_when_any_done=False)
    assert set(policy.in_keys) <= set(walk.keys(True, True))
    assert walk["is_init"].squeeze(-1).nonzero()[:, 1].unique().tolist() == [0, 5, 10]
    paid = walk["next", "intrinsic_reward"].clamp(-1, 1)
    assert torch.equal(walk["next", "previous_reward"], paid)


def test_another_reward_can_be_the_one_that_is_read():
    policy = make_policy()
    steps = make_novelty_reward(Pixels(), 0.8)
    steps += make_policy_inputs(policy, reward="count_reward")
    env = TransformedEnv(FakeMaze(batch_size=[2], max_decisions=5), Compose(*steps))
    walk = env.rollout(4)["next"]
    assert torch.equal(walk["previous_reward"], walk["count_reward"])


@pytest.mark.parametrize("alpha", [-0.1, 1.1, float("nan")])
def test_a_weight_out_of_range_is_refused(alpha):
    with pytest.raises(ValueError, match=r"alpha must be in \[0, 1\], got"):
        make_novelty_reward(Pixels(), 0.5, alpha=alpha)


def test_what_lacks_a_part_is_refused_by_name():
    with pytest.raises(
        TypeError, match="such as a TCNetwork, got Linear without embed, prepare_mem"
    ):
        make_novelty_reward(torch.nn.Linear(2, 2), 0.5)
    with pytest.raises(
        TypeError, match="such as an ActorCritic, got Linear without num_actions, make"
    ):
        make_policy_inputs(torch.nn.Linear(2, 2))
