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


def test_its_numbers_are_sums_over_the_episode() -> None:
    assert episodes.trace().numbers() == pytest.approx(
        {
            "coverage": 0.8,
            "intrinsic_return": 6.5,  # 1 + 2 + 0.5 + 3
            "count_return": 1.625,  # a quarter
            "temporal_distance_return": 4.875,
            "new_waypoints": 2,  # the first waypoint does not count
            "spurious_waypoints": 1,
            "waypoints": 3,
        }
    )


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
    for name in ("intrinsic_reward", "count_reward", "temporal_distance_reward"):
        del data["next", name]
    found = trace_episode(data).numbers()
    assert found.pop("coverage") == pytest.approx(0.8)
    assert set(found.values()) == {0.0}


def test_what_is_no_episode_is_refused() -> None:
    with pytest.raises(ValueError, match=r"episode must be \[T\], got \(1, 4\)"):
        trace_episode(episodes.episode().unsqueeze(0))
    data = episodes.episode()
    del data["next", "privileged", "coverage"]
    with pytest.raises(KeyError, match="coverage"):
        trace_episode(data)
