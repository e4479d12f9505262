import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from toponav.ground_truth import PairTruth
from toponav.metrics import (
    most_similar,
    pose_bound,
    pose_features,
    tc_report,
)
from toponav.metrics.tc_report import binned_mean


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


def judge(similarity, label, truth=None):
    truth = make_truth([10.0] * len(label)) if truth is None else truth
    return tc_report(similarity, label, truth, cell_size=128.0)


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
    report = tc_report(similarity, label, truth, cell_size=128.0)
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
    report = judge(torch.tensor([0.9, 0.9, 0.1]), torch.tensor([1, 1, 0]), truth)
    assert report.positives_far == 0.5


def test_numbers_are_floats_and_no_curves():
    truth = make_truth([10.0, 500.0])
    numbers = judge(torch.tensor([0.9, 0.1]), torch.tensor([1, 0]), truth).numbers()
    assert numbers["accuracy"] == 1.0
    assert math.isnan(numbers["through_wall_rate"])
    assert all(isinstance(value, float) for value in numbers.values())
    assert "roc" not in numbers


def test_lengths_must_agree():
    with pytest.raises(ValueError, match="must be of one length, got 3, 2 and 2"):
        judge(torch.rand(3), torch.tensor([1, 0]), make_truth([10.0, 500.0]))


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 5), st.booleans()), min_size=2).filter(
        lambda pairs: len({label for _, label in pairs}) == 2
    )
)
def test_area_is_the_share_of_pairs_in_order_and_the_one_under_the_curve(pairs):
    score, label = zip(*pairs, strict=True)
    score, label = torch.tensor(score) / 5, torch.tensor(label)
    gap = score[label].unsqueeze(1) - score[~label]
    expected = ((gap > 0).double() + 0.5 * (gap == 0).double()).mean()
    found = judge(score, label)
    assert found.auc == pytest.approx(float(expected), abs=1e-12)
    false_rate, true_rate = found.roc
    area = torch.trapezoid(true_rate, false_rate)
    assert float(area) == pytest.approx(found.auc, abs=1e-12)
    assert (false_rate[0], true_rate[0]) == (0, 0)
    assert (false_rate[-1], true_rate[-1]) == (1, 1)


def test_calibration_error_by_hand():
    # Bin .2-.3: said .25 twice, true 1/2, error .25. Bin .9-1: said 1 twice, true
    # 1/2, error .5. Mean over four pairs: .375.
    said = torch.tensor([0.25, 0.25, 1.0, 1.0])
    found = judge(said, torch.tensor([0, 1, 1, 0]))
    assert found.calibration_error == pytest.approx(0.375)


def test_calibration_error_of_a_perfect_predictor_vanishes():
    generator = torch.Generator().manual_seed(0)
    said = torch.rand(400_000, generator=generator)
    label = torch.rand(400_000, generator=generator) < said
    # The error of one bin of 40,000 is at most .5 / 200 = .0025, their mean less.
    assert judge(said, label).calibration_error < 0.0035
    # And one who always says .1 more is off by as much.
    assert judge(said * 0.9 + 0.1, label).calibration_error > 0.03


def test_bins_hold_their_lower_edge_and_the_last_one_both():
    by = torch.tensor([-0.1, 0.0, 1.0, 2.0, 2.1, torch.inf])
    found = binned_mean(torch.arange(6.0), by, [0.0, 1.0, 2.0])
    assert found.count.tolist() == [1, 2]
    assert found.mean.tolist() == [1.0, 2.5]  # 1; (2 + 3) / 2
    assert found.centres.tolist() == [0.5, 1.5]


def test_empty_bin_has_no_mean():
    found = binned_mean(torch.ones(1), torch.ones(1), [0.0, 0.5, 1.0])
    assert math.isnan(found.mean[0])
    assert found.count.tolist() == [0, 1]


def test_bad_scores_are_refused():
    for wrong in (torch.nan, 1.5):
        with pytest.raises(ValueError, match=r"similarity must lie in \[0, 1\]"):
            judge(torch.tensor([0.1, wrong]), torch.tensor([0, 1]))
    with pytest.raises(ValueError, match="got 2 positives among 2 pairs"):
        judge(torch.tensor([0.1, 0.2]), torch.tensor([1, 1]))


def test_views_of_one_visit_do_not_stand_for_each_other():
    episode, step = torch.tensor([0, 0, 0, 1]), torch.tensor([0, 19, 20, 0])
    # Of views that are all alike, each finds the first that is of another visit.
    found = most_similar(
        torch.ones(4, 4), episode, step, rows=torch.arange(4), min_gap=20
    )
    assert found.tolist() == [2, 3, 0, 0]


def test_the_most_similar_view_is_of_another_visit_or_none():
    similarity = torch.tensor([[1.0, 0.9, 0.2], [0.9, 1.0, 0.3], [0.2, 0.3, 1.0]])
    rows, zeros, step = torch.arange(3), torch.zeros(3), torch.tensor([0, 1, 30])

    def found(episode, gap):
        return most_similar(similarity, episode, step, rows=rows, min_gap=gap).tolist()

    assert found(zeros, 1) == [1, 0, 1]
    assert found(zeros, 20) == [2, 2, 1]
    assert found(zeros, 30) == [2, -1, 0]
    assert found(torch.tensor([0, 1, 1]), 99) == [1, 0, 0]


def test_some_views_look_among_all():
    episode, step = torch.tensor([0, 0, 0, 1]), torch.tensor([0, 1, 30, 0])
    similarity = torch.rand(4, 4, generator=torch.Generator().manual_seed(0))
    rows = torch.tensor([2, 0])
    some = most_similar(similarity[rows], episode, step, rows=rows, min_gap=20)
    every = torch.arange(4)
    all_rows = most_similar(similarity, episode, step, rows=every, min_gap=20)
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
    assert pose_bound((features, label), test) > 0.95
    coin = torch.rand(20_000, generator=torch.Generator().manual_seed(2)).round()
    useless = pose_bound((features, coin), (test[0], coin[:4_000]))
    assert 0.45 < useless < 0.55


def test_pose_bound_repeats_and_refuses_nothing_to_learn_from():
    train, test = pose_pairs(2_000, 0), pose_pairs(500, 1)
    assert pose_bound(train, test) == pose_bound(train, test)
    with pytest.raises(ValueError, match="pairs must not be empty, got 0 to train"):
        pose_bound((train[0][:0], train[1][:0]), test)
