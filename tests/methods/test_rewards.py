"""What all reward methods have in common."""

import pytest

from tests.exploring import explore_settings, world_of
from toponav.methods import REWARDS, make_reward


@pytest.mark.parametrize("name", REWARDS)
def test_collectors_get_all_weights_that_a_method_trains(name: str) -> None:
    config = explore_settings(f"reward={name}")
    method = make_reward(config, world_of(config), None)
    expected = {name} if name in ("rnd", "icm", "vime", "ex2") else set()
    assert set(method.modules()) == set(method.updated()) == expected
