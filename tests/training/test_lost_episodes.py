"""A collecting process that dies takes its episodes along; the next ones are others."""

import pytest
import torch

from tests.exploring import explore_settings, make_batch
from tests.training.test_episode_log import add, make_log
from tests.training.test_map_growth import make_growth, make_walk, settings
from toponav.keys import INTRINSIC_REWARD


def test_what_was_lost_is_not_in_the_sums_of_the_next_episode() -> None:
    config = explore_settings()
    log = make_log(4)
    lost, *pieces = (
        make_batch(config, start=start, seed=seed)
        for seed, start in enumerate((0, 0, 32))
    )
    assert add(log, lost) == add(log, pieces[0]) == []
    ended = add(log, pieces[1])
    assert len(ended) == 4
    for env, row in enumerate(ended):
        paid = torch.cat([piece["next", INTRINSIC_REWARD][env] for piece in pieces])
        assert row["intrinsic_return"] == pytest.approx(float(paid.double().sum()))
    assert log.last_episode is not None
    assert len(log.last_episode) == 64
    seen = torch.cat([piece["next", "step_count"][0, :, 0] for piece in pieces])
    assert torch.equal(log.last_episode["next", "step_count"][:, 0], seen)


@pytest.mark.parametrize("start", [0, 32])
def test_no_edge_joins_what_was_lost_to_the_next_episode(start: int) -> None:
    config = settings()
    growth = make_growth(config)
    growth.extend(make_walk(config, start=0, seed=1))
    growth.extend(make_walk(config, start=start, seed=2))
    number = growth.map.waypoints.origins[:, 1]
    before = number[torch.as_tensor(growth.map.edges)] < 32
    joined = bool((before[:, 0] != before[:, 1]).any())
    # What follows on is joined, what begins at 0 is not.
    assert joined == (start == 32)


@pytest.mark.parametrize("start", [0, 32])
def test_no_walk_goes_over_what_was_lost(start: int) -> None:
    config = settings("map.poses=true")
    growth = make_growth(config)
    growth.extend(make_walk(config, start=0, seed=1))
    growth.extend(make_walk(config, start=start, seed=2))
    assert growth.walks is not None
    lengths = [len(walk.actions) for walk in growth.walks.all()]
    assert lengths == ([64] * 4 if start else [32] * 8)
