import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from toponav.transforms import count_reward, temporal_distance_reward

shares = st.floats(0, 1, width=32)


def test_count_reward_worked_numbers():
    # 0.3 / sqrt(1), / sqrt(2), / sqrt(9); no visit pays nothing.
    paid = count_reward(torch.tensor([[1, 2], [9, 0]]), alpha=0.3)
    expected = torch.tensor([[0.3, 0.3 / math.sqrt(2)], [0.1, 0.0]])
    torch.testing.assert_close(paid, expected)
    assert paid.dtype is torch.float32


def test_staying_put_for_an_episode_pays_about_two_alpha_root_t():
    # The sum of 1 / sqrt(n) up to T is 2 sqrt(T) - 1.46, 83.4 for T = 1800.
    total = count_reward(torch.arange(1, 1801), alpha=0.2).sum().item()
    assert total == pytest.approx(0.2 * (2 * math.sqrt(1800) - 1.46), rel=1e-3)


@settings(deadline=None)
@given(visits=st.integers(1, 10**6), alpha=st.floats(0, 2))
def test_a_further_visit_never_pays_more(visits, alpha):
    now, then = count_reward(torch.tensor([visits, visits + 1]), alpha)
    assert 0 <= then <= now <= alpha * (1 + 1e-6)


def test_temporal_distance_reward_worked_numbers():
    # 0.8 / 0.8, 0.8 / 0.5; below the floor 0.8 / 0.05 = 16.
    similarity = torch.tensor([0.8, 0.5, 0.02, 0.0])
    paid = temporal_distance_reward(similarity, beta=0.8)
    torch.testing.assert_close(paid, torch.tensor([1.0, 1.6, 16.0, 16.0]))
    paid = temporal_distance_reward(similarity, beta=0.8, floor=0.1)
    torch.testing.assert_close(paid, torch.tensor([1.0, 1.6, 8.0, 8.0]))


@settings(deadline=None)
@given(one=shares, other=shares)
def test_less_similar_never_pays_less(one, other):
    low, high = sorted((one, other))
    far, near = temporal_distance_reward(torch.tensor([low, high]), 1.0)
    assert 1.0 <= near <= far <= 1 / 0.05


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: count_reward(torch.tensor([1]), -0.1), "alpha must be .* got -0.1"),
        (lambda: temporal_distance_reward(torch.ones(1), -1.0), "beta must be"),
        (
            lambda: temporal_distance_reward(torch.ones(1), 1.0, floor=0.0),
            r"floor must be in \(0, 1\], got 0.0",
        ),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
