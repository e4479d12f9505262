import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from toponav.evaluation import (
    balanced_accuracy,
    expected_calibration_error,
    roc_auc,
    roc_curve,
)
from toponav.evaluation.classification import binned_mean, calibration_curve

SCORES = st.lists(
    st.tuples(st.integers(0, 5), st.booleans()), min_size=2, max_size=40
).filter(lambda pairs: len({label for _, label in pairs}) == 2)


def unzip(pairs):
    score, label = zip(*pairs, strict=True)
    return torch.tensor(score, dtype=torch.float32), torch.tensor(label).float()


@settings(max_examples=100, deadline=None)
@given(pairs=SCORES)
def test_auc_is_the_share_of_pairs_in_order(pairs):
    score, label = unzip(pairs)
    gap = score[label == 1].unsqueeze(1) - score[label == 0]
    expected = ((gap > 0).double() + 0.5 * (gap == 0).double()).mean()
    assert roc_auc(score, label) == pytest.approx(float(expected), abs=1e-12)


@settings(max_examples=100, deadline=None)
@given(pairs=SCORES)
def test_area_under_the_curve_is_the_auc(pairs):
    score, label = unzip(pairs)
    false_rate, true_rate = roc_curve(score, label)
    area = torch.trapezoid(true_rate, false_rate)
    assert float(area) == pytest.approx(roc_auc(score, label), abs=1e-12)
    assert (false_rate[0], true_rate[0]) == (0, 0)
    assert (false_rate[-1], true_rate[-1]) == (1, 1)


@settings(max_examples=50, deadline=None)
@given(pairs=SCORES, seed=st.integers(0, 99))
def test_auc_knows_neither_order_nor_scale(pairs, seed):
    score, label = unzip(pairs)
    order = torch.randperm(len(score), generator=torch.Generator().manual_seed(seed))
    auc = roc_auc(score, label)
    assert roc_auc(score[order].exp(), label[order]) == pytest.approx(auc, abs=1e-12)
    assert roc_auc(-score, label) == pytest.approx(1 - auc, abs=1e-12)


def test_balanced_accuracy_weighs_the_classes_alike():
    # 1 of 1 positive, 1 of 3 negatives: (1 + 1/3) / 2.
    prediction = torch.tensor([True, True, True, False])
    label = torch.tensor([1, 0, 0, 0])
    assert balanced_accuracy(prediction, label) == pytest.approx(2 / 3)


def test_calibration_error_by_hand():
    # Bin .2-.3: said .25 twice, true 1/2, error .25. Bin .9-1: said 1 twice, true
    # 1/2, error .5. Mean over four pairs: .375.
    said = torch.tensor([0.25, 0.25, 1.0, 1.0])
    label = torch.tensor([0, 1, 1, 0])
    assert expected_calibration_error(said, label) == pytest.approx(0.375)


def test_calibration_error_of_a_perfect_predictor_vanishes():
    generator = torch.Generator().manual_seed(0)
    said = torch.rand(400_000, generator=generator)
    label = torch.rand(400_000, generator=generator) < said
    # The error of one bin of 40,000 is at most .5 / 200 = .0025, their mean less.
    assert expected_calibration_error(said, label) < 0.0035
    # And one who always says .1 more is off by as much.
    assert expected_calibration_error(said * 0.9 + 0.1, label) > 0.03


def test_bins_hold_their_lower_edge_and_the_last_one_both():
    edges = torch.tensor([0.0, 1.0, 2.0])
    by = torch.tensor([-0.1, 0.0, 1.0, 2.0, 2.1])
    found = binned_mean(torch.arange(5.0), by, edges)
    assert found.count.tolist() == [1, 2]
    assert found.mean.tolist() == [1.0, 2.5]  # 1; (2 + 3) / 2
    assert found.centres.tolist() == [0.5, 1.5]


def test_empty_bin_has_no_mean():
    found = binned_mean(torch.ones(1), torch.ones(1), torch.tensor([0.0, 0.5, 1.0]))
    assert math.isnan(found.mean[0])
    assert found.count.tolist() == [0, 1]


def test_bad_scores_are_refused():
    with pytest.raises(ValueError, match="got NaN"):
        roc_auc(torch.tensor([0.1, torch.nan]), torch.tensor([0, 1]))
    with pytest.raises(ValueError, match="got 2 positives among 2 pairs"):
        roc_curve(torch.tensor([0.1, 0.2]), torch.tensor([1, 1]))
    with pytest.raises(ValueError, match=r"must lie in \[0, 1\]"):
        calibration_curve(torch.tensor([1.5]), torch.tensor([1]))
