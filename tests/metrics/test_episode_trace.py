import numpy as np
import pytest
import torch

from tests import episodes
from toponav.metrics import trace_episode


def test_a_trace_holds_all_observations_in_order() -> None:
    found = episodes.trace()
    assert found.positions.tolist() == [[x, 64.0] for x in episodes.X]
    assert found.headings.tolist() == [0, 0, 0, 180, 0]
    assert found.cells.tolist() == [[0, cell] for cell in episodes.CELLS]
    assert found.reward.tolist() == episodes.REWARD
    np.testing.assert_allclose(found.coverage, episodes.COVERAGE)
    assert found.is_new_waypoint.tolist() == episodes.IS_NEW_WAYPOINT
    assert found.spurious_waypoint.tolist() == episodes.FALSE


def test_a_reward_at_the_start_is_not_of_this_episode() -> None:
    data = episodes.episode()
    data["intrinsic_reward"] = torch.full((4, 1), 9.0)
    assert trace_episode(data).reward.tolist() == episodes.REWARD


def test_an_episode_without_novelty_has_neither_rewards_nor_waypoints() -> None:
    data = episodes.episode()
    for key in (
        "is_new_waypoint",
        ("next", "is_new_waypoint"),
        ("privileged", "spurious_waypoint"),
    ):
        del data[key]
    del data["next", "privileged", "spurious_waypoint"]
    del data["next", "intrinsic_reward"]
    found = trace_episode(data)
    assert found.coverage[-1] == pytest.approx(0.8)
    for values in (found.reward, found.is_new_waypoint, found.spurious_waypoint):
        assert not values.any()


def test_what_is_no_episode_is_refused() -> None:
    with pytest.raises(ValueError, match=r"episode must be \[T\], got \(1, 4\)"):
        trace_episode(episodes.episode().unsqueeze(0))
    data = episodes.episode()
    del data["next", "privileged", "coverage"]
    with pytest.raises(KeyError, match="coverage"):
        trace_episode(data)
