"""The paper's reward as a method: its settings become transforms."""

import pytest

from tests.exploring import explore_settings, world_of
from toponav.builders import make_networks
from toponav.methods import make_reward

THRESHOLDS = {"reward_threshold": 0.5, "tc_threshold": 0.9, "tc_reach": 0.7}


@pytest.mark.parametrize(("capacity", "most"), [("null", 33), ("7", 7)])
def test_without_a_limit_every_view_of_an_episode_may_be_a_waypoint(
    capacity: str, most: int
) -> None:
    # The first view comes before the first of the 32 decisions.
    words = (f"reward.capacity={capacity}", "maze.episode_length=32")
    config = explore_settings(*words)
    world = world_of(config)
    networks = make_networks(config.model, world.spec)
    networks.thresholds = dict(THRESHOLDS)
    memory = make_reward(config, world, networks).make_transforms(num_envs=1, seed=0)[0]
    assert memory.slots.capacity == most
