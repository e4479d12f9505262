import math

import pytest
import torch

from toponav.evaluation import (
    PairTruth,
    most_similar,
    pair_candidates,
    place_error,
    pose_bound,
    pose_features,
    tc_report,
)


def make_truth(distance, heading=None, *, through_wall=None):
    distance = torch.tensor(distance)
    heading = torch.zeros_like(distance) if heading is None else torch.tensor(heading)
    if through_wall is None:
        through_wall = torch.zeros(len(distance), dtype=torch.bool)
    steps, turns = distance / 33.1, heading / 20
    return PairTruth(
        distance=distance,
        straight=distance,
        heading_difference=heading,
        decisions=steps + turns,
        least_decisions=torch.maximum(steps, turns),
        through_wall=torch.as_tensor(through_wall),
    )


def test_rates_by_hand():
    # Positives .9 and .4 : 1 of 2 near. Negatives .2, .6, .1, .3: 3 of 4 not near.
    # Of the 8 mixed pairs, (.9, any) 4 and (.4: .2, .1, .3) 3 are in order: 7/8.
    similarity = torch.tensor([0.9, 0.4, 0.2, 0.6, 0.1, 0.3])
    label = torch.tensor([1, 1, 0, 0, 0, 0])
    # Negatives: 1 step and 2 turns, 3 decisions, are near; 5 steps are not, nor are
    # 3 steps and 3 turns.
    truth = make_truth(
        [33.1, 66.2, 33.1, 165.5, 99.3, 1000.0],
        [0.0, 0.0, 40.0, 0.0, 60.0, 90.0],
        through_wall=[False, False, False, True, True, False],
    )
    report = tc_report(similarity, label, truth)
    assert (report.positive_accuracy, report.negative_accuracy) == (0.5, 0.75)
    assert report.accuracy == pytest.approx(0.625)
    assert report.auc == pytest.approx(7 / 8)
    assert report.negatives_near == pytest.approx(1 / 4)
    assert report.positives_far == 0
    assert (report.through_wall_rate, report.num_through_wall) == (0.5, 2)
    # The pairs 1/4 to 1/2 cells apart: .9 positive and .2 negative, both right.
    assert report.by_distance.mean[1] == 1
    assert report.by_distance.count[1] == 2
    assert report.similarity[0, 1] == pytest.approx(0.9)
    assert report.similarity[1, 1] == pytest.approx(0.2)
    assert report.similarity_count.sum() == 6


def test_positives_that_no_walker_could_do_are_counted():
    # 33.1 * 4 = 132.4 is the most in four decisions.
    truth = make_truth([132.4, 300.0, 500.0])
    report = tc_report(torch.tensor([0.9, 0.9, 0.1]), torch.tensor([1, 1, 0]), truth)
    assert report.positives_far == 0.5


def test_numbers_are_floats_and_no_curves():
    truth = make_truth([10.0, 500.0])
    numbers = tc_report(torch.tensor([0.9, 0.1]), torch.tensor([1, 0]), truth).numbers()
    assert numbers["accuracy"] == 1.0
    assert math.isnan(numbers["through_wall_rate"])
    assert all(isinstance(value, float) for value in numbers.values())
    assert "roc" not in numbers


def test_lengths_must_agree():
    with pytest.raises(ValueError, match="must be of one length, got 3, 2 and 2"):
        tc_report(torch.rand(3), torch.tensor([1, 0]), make_truth([10.0, 500.0]))


def test_views_of_one_moment_do_not_stand_for_each_other():
    episode = torch.tensor([0, 0, 0, 1])
    step = torch.tensor([0, 19, 20, 0])
    found = pair_candidates(episode, step, min_gap=20)
    expected = [[0, 0, 1, 1], [0, 0, 0, 1], [1, 0, 0, 1], [1, 1, 1, 0]]
    assert found.int().tolist() == expected
    with pytest.raises(ValueError, match="min_gap must be at least 1, got 0"):
        pair_candidates(episode, step, min_gap=0)


def test_place_error_looks_only_at_candidates():
    similarity = torch.tensor([[1.0, 0.9, 0.2], [0.9, 1.0, 0.3], [0.2, 0.3, 1.0]])
    distance = torch.tensor([[0.0, 10.0, 300.0], [10.0, 0.0, 256.0], [300.0, 256.0, 0]])

    def error(candidates):
        best = most_similar(similarity, candidates)
        found = distance[torch.arange(3), best]
        return place_error(torch.where(best >= 0, found, torch.nan))

    others = ~torch.eye(3, dtype=torch.bool)
    assert error(others) == 0  # 2's nearest is at 256
    without = others.clone()
    without[0, 1] = False  # 0 must take 2, at 300
    assert error(without) == pytest.approx(1 / 3)
    without[1] = False  # and 1 is left out
    assert error(without) == pytest.approx(1 / 2)


def test_some_views_look_among_all():
    episode, step = torch.tensor([0, 0, 0, 1]), torch.tensor([0, 1, 30, 0])
    all_rows = pair_candidates(episode, step, min_gap=20)
    rows = torch.tensor([2, 0])
    some = pair_candidates(episode, step, min_gap=20, rows=rows)
    assert torch.equal(some, all_rows[rows])


def pose_pairs(num, seed):
    """Poses in free space; near if the least walk takes at most four decisions."""
    generator = torch.Generator().manual_seed(seed)
    here = 800 * torch.rand(num, 2, generator=generator)
    there = here + 150 * torch.randn(num, 2, generator=generator)
    headings = 360 * torch.rand(2, num, generator=generator)
    turn = ((headings[0] - headings[1] + 180) % 360 - 180).abs()
    truth = make_truth((here - there).norm(dim=-1).tolist(), turn.tolist())
    features = pose_features((here, there), (headings[0], headings[1]), truth)
    return features, (truth.least_decisions <= 4).float()


def test_pose_bound_learns_what_poses_tell_and_not_what_they_do_not():
    features, label = pose_pairs(20_000, 0)
    test = pose_pairs(4_000, 1)
    assert pose_bound((features, label), test, steps=400) > 0.95
    coin = torch.rand(20_000, generator=torch.Generator().manual_seed(2)).round()
    useless = pose_bound((features, coin), (test[0], coin[:4_000]), steps=100)
    assert 0.45 < useless < 0.55


def test_pose_bound_repeats_and_leaves_the_random_state():
    train, test = pose_pairs(2_000, 0), pose_pairs(500, 1)
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    first = pose_bound(train, test, steps=20)
    assert torch.rand(1) == expected
    assert pose_bound(train, test, steps=20) == first
    with pytest.raises(ValueError, match="pairs must not be empty, got 0 to train"):
        pose_bound((train[0][:0], train[1][:0]), test)
