import pytest
import torch

from tests.comparing_networks import Lookup, Nearness
from toponav.graph import (
    MAP_SHARE,
    REWARD_SHARE,
    WalkWaypoints,
    calibrate_map,
    calibrate_reach,
    calibrate_share,
)


def walks(num=6, length=400):
    generator = torch.Generator().manual_seed(3)
    places = [torch.randn(length, 2, generator=generator) for _ in range(num)]
    return [WalkWaypoints(steps.cumsum(0), Nearness()) for steps in places]


def alike(network):
    """The walk whose similarities a network looks up."""
    return WalkWaypoints(network.sequence, network)


@pytest.mark.parametrize("share", [0.015, 0.125, 0.5])
def test_share_is_met_and_reported_truly(share):
    sequences = walks()
    found = calibrate_share(sequences, target_share=share)
    assert found.achieved == pytest.approx(share, rel=0.15)
    again = [walk.share(found.threshold) for walk in sequences]
    assert found.per_sequence == tuple(again)
    assert found.achieved == pytest.approx(sum(again) / len(again))


def test_rules_ask_for_the_shares_they_state():
    tc, reward = (
        calibrate_share(walks(), target_share=share)
        for share in (MAP_SHARE, REWARD_SHARE)
    )
    assert (tc.target, reward.target) == (0.125, 0.015)
    assert reward.threshold < tc.threshold


def test_order_of_the_sequences_is_of_no_matter():
    one = calibrate_share(walks(), target_share=MAP_SHARE)
    two = calibrate_share(walks()[::-1], target_share=MAP_SHARE)
    assert one.threshold == two.threshold


def test_monotone_change_of_the_similarity_changes_nothing_but_the_number():
    generator = torch.Generator().manual_seed(3)
    at = torch.randn(400, 2, generator=generator).cumsum(0)
    plain = 1 / (1 + torch.cdist(at, at))
    found = [
        calibrate_share([alike(network)], target_share=MAP_SHARE)
        for network in (Lookup(plain), Lookup(plain**3))
    ]
    assert found[0].achieved == pytest.approx(0.125, abs=0.01)
    assert found[0].achieved == pytest.approx(found[1].achieved, abs=0.01)
    assert found[1].threshold == pytest.approx(found[0].threshold ** 3, rel=0.1)


def test_network_that_says_the_same_to_all_gets_the_closest_share():
    network = Lookup(torch.full((40, 40), 0.3))
    found = calibrate_share([alike(network)], target_share=MAP_SHARE)
    # One waypoint of 40 is closer to an eighth than 40 of 40.
    assert found.achieved == 1 / 40
    assert found.threshold < 0.3


def test_reach_lets_nine_in_ten_near_pairs_pass():
    # Pairs one apart score .01 t: 1..100 of them, of which 90 lie above .10.
    # The floor of 0.5 lies above that, so scale into (0.5, 1).
    table = torch.zeros(101, 101)
    later = torch.arange(1, 101)
    table[later, later - 1] = 0.5 + later / 250
    network = Lookup(table)
    found = calibrate_reach([alike(network)], tc_threshold=0.95, max_action_distance=1)
    assert 0.5 + 10 / 250 <= found.threshold < 0.5 + 11 / 250
    assert found.achieved == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("level", "expected"),
    # 5 % of (0.5, 0.9) is 0.02.
    [(0.3, 0.52), (0.97, 0.88)],
)
def test_reach_stays_between_a_half_and_the_threshold(level, expected):
    network = Lookup(torch.full((30, 30), level))
    found = calibrate_reach([alike(network)], tc_threshold=0.9)
    assert found.threshold == pytest.approx(expected)
    assert found.achieved == float(level > expected)


def test_reach_of_a_useless_network_is_its_threshold():
    network = Lookup(torch.full((30, 30), 0.3))
    found = calibrate_reach([alike(network)], tc_threshold=0.4)
    assert found.threshold == pytest.approx(0.4)


@pytest.mark.parametrize("share", [0.0, 1.0, -1.0])
def test_share_must_be_possible(share):
    with pytest.raises(ValueError, match=r"target_share must lie in \(0, 1\)"):
        calibrate_share(walks(1, 5), target_share=share)


def test_there_must_be_sequences_and_pairs():
    with pytest.raises(ValueError, match="must hold at least one"):
        calibrate_share([], target_share=MAP_SHARE)
    with pytest.raises(ValueError, match="episode must hold two observations"):
        calibrate_reach(walks(1, 1), tc_threshold=0.9)


def test_a_network_of_another_kind_is_refused():
    with pytest.raises(TypeError, match="got Linear without prepare_memory, comp"):
        WalkWaypoints(torch.zeros(3, 2), torch.nn.Linear(2, 2))


def test_a_map_gets_both_thresholds():
    sequences = walks()
    rules = calibrate_map(sequences, max_action_distance=2, window=0)
    share = calibrate_share(sequences, target_share=MAP_SHARE)
    assert rules.tc_threshold == share.threshold
    reach = calibrate_reach(
        sequences, tc_threshold=share.threshold, max_action_distance=2
    )
    assert rules.tc_reach == reach.threshold
    assert rules.window == 0


def test_an_episodic_memory_is_empty_where_an_episode_begins():
    at, episode = torch.tensor([0.0, 2, 0, 2, 0, 0]), torch.tensor([0, 0, 1, 1, 2, 2])
    walk = WalkWaypoints(at.unsqueeze(1), Nearness(), episode)
    # Two apart is 1 / 3 alike.
    assert walk.times(0.5) == [0, 1]
    assert walk.share(0.5) == 2 / 6
    assert walk.times(0.5, episodic=True) == [0, 1, 2, 3, 4]
    # Without those at 2 and 4, which begin an episode.
    assert walk.share(0.5, episodic=True) == 3 / 6
    # A checkpoint of networks that continue training has it, and reads no NumPy.
    assert type(walk.share(0.5, episodic=True)) is float
    assert walk.share(0.1, episodic=True) == (3 - 2) / 6


def test_a_walk_of_one_episode_is_the_same_to_either_memory():
    for walk in walks(2, 60):
        for threshold in (0.2, 0.4, 0.6):
            times = walk.times(threshold, episodic=True)
            assert times == walk.times(threshold)
            assert walk.share(threshold, episodic=True) == len(times) / 60


def test_views_of_two_episodes_are_no_pair_for_the_reach():
    table = torch.full((20, 20), 0.8)
    table[10:, :10] = 0.55  # over the end after ten views
    sequence, network = Lookup(table).sequence, Lookup(table)
    given = {"tc_threshold": 0.9, "max_action_distance": 4}
    # Of 19 + 18 + 17 + 16 pairs 1 + 2 + 3 + 4 lie over the end, a seventh.
    found = calibrate_reach([WalkWaypoints(sequence, network)], **given)
    assert found.threshold == pytest.approx(0.55)
    episode = torch.arange(20) // 10
    found = calibrate_reach([WalkWaypoints(sequence, network, episode)], **given)
    assert found.threshold == pytest.approx(0.8)


def test_every_observation_has_an_episode():
    with pytest.raises(
        ValueError, match=r"episode must be \[3\], a number .*got \[2\]"
    ):
        WalkWaypoints(torch.zeros(3, 2), Nearness(), torch.zeros(2))
