import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from rliable.metrics import aggregate_iqm

from toponav.metrics import (
    Scores,
    bootstrap,
    correlation,
    markdown_table,
    running_mean,
    summarize_scores,
)
from toponav.metrics.statistics import top_mean

NAN = float("nan")
FLOATS = st.floats(-1000, 1000)


def lists(most: int = 12) -> st.SearchStrategy[np.ndarray]:
    return arrays(np.float64, st.integers(1, most), elements=FLOATS)


@pytest.mark.parametrize(
    ("values", "middle"),
    [
        ([7.0], 7.0),
        ([1.0, 2.0, 9.0], 4.0),  # a quarter of three, rounded down, is none
        ([90.0, 2.0, 4.0, 1.0], 3.0),  # 2 and 4 are left
        ([8, 1, 2, 3, 4, 5, 6, 7], 4.5),  # 3, 4, 5, 6 are left
        ([8, 1, 2, 3, 4, 5, 6, 7, 99], 5.0),  # 9 // 4 = 2 off: 3 to 7 are left
    ],
)
def test_interquartile_mean_is_that_of_the_middle_half(
    values: list[float], middle: float
) -> None:
    assert bootstrap(values, aggregate_iqm, draws=1).value == pytest.approx(middle)


def test_the_top_five_are_picked_among_all() -> None:
    # 10 + 9 + 8 + 7 + 6 = 40, over two rows.
    assert top_mean([[1, 10, 3, 8, 5], [6, 7, 4, 9, 2]]) == 8.0
    assert np.isnan(top_mean([1, 2, 3]))


@given(arrays(np.float64, st.integers(5, 20), elements=FLOATS))
def test_the_top_five_flatter(values: np.ndarray) -> None:
    assert top_mean(values) >= values.mean() - 1e-9


def test_the_best_draws_are_those_of_runs_and_not_of_episodes() -> None:
    # Seven draws with two episodes each: the best episode is not one of the best draw.
    values = np.array([[1.0, 1], [2, 2], [0, 9], [4, 4], [5, 5], [6, 6], [7, 7]])
    draws = [f"lr {number}" for number in range(7)]
    scores = Scores({}, "best", "coverage (%)", values, draws=draws)
    assert [draw for _, draw in scores.best_draws] == [
        *("lr 6", "lr 5", "lr 4", "lr 2", "lr 3")
    ]
    table = summarize_scores([scores], subject="policy")
    # 7, 6, 5, 4.5 and 4, beside the mean of all seven.
    assert table["top_5_draws"][0] == pytest.approx(5.3)
    assert table["mean"][0].value == pytest.approx(values.mean())
    assert "| top 5 draws |" in markdown_table(table)
    few = Scores({}, "best", "coverage (%)", values[:3], draws=draws[:3])
    assert math.isnan(summarize_scores([few], subject="policy")["top_5_draws"][0])
    plain = Scores({}, "best", "coverage (%)", values)
    assert "top_5_draws" not in summarize_scores([plain], subject="policy")


def test_an_interval_of_a_mean_is_that_of_the_normal_law() -> None:
    # 400 values with standard deviation 10: 1.96 * 10 / sqrt(400) = 0.98 to each side.
    values = np.random.default_rng(1).normal(50, 10, 400)
    values = (values - values.mean()) / values.std() * 10 + 50
    found = bootstrap(values)
    assert found.value == pytest.approx(50)
    assert found.low == pytest.approx(50 - 0.98, abs=0.05)
    assert found.high == pytest.approx(50 + 0.98, abs=0.05)


@pytest.mark.slow
def test_an_interval_covers_the_truth_as_often_as_it_says() -> None:
    generator = np.random.default_rng(2)
    hits = 0
    for trial in range(300):
        found = bootstrap(generator.normal(0, 1, 30), draws=400, seed=trial, level=0.8)
        hits += found.low <= 0 <= found.high
    # Standard error of a share of 0.8 over 300 trials: 0.023.
    assert hits / 300 == pytest.approx(0.8, abs=0.07)


def test_runs_that_differ_widen_the_interval() -> None:
    # The same 40 values: once as one list, once as runs that differ from each other.
    runs = np.repeat([[0.2], [0.4], [0.6], [0.8]], 10, axis=1)
    together, apart = bootstrap(runs.reshape(-1)), bootstrap(runs)
    assert together.value == apart.value == pytest.approx(0.5)
    # Standard error of a mean of 40: 0.224 / sqrt(40) = 0.035; of 4 runs: 0.112.
    assert together.high - together.low == pytest.approx(2 * 1.96 * 0.035, abs=0.02)
    assert apart.high - apart.low == pytest.approx(2 * 1.96 * 0.112, abs=0.05)


def test_mazes_are_not_drawn() -> None:
    # Two mazes as different as can be, whose runs do not differ: nothing is unsure.
    apart = bootstrap(np.repeat([0.0, 10.0], 4).reshape(2, 2, 2))
    assert (apart.low, apart.value, apart.high) == (5, 5, 5)
    # Standard error of 4 runs: 0.112. Seeds are drawn for both mazes together.
    runs = np.repeat([[0.2], [0.4], [0.6], [0.8]], 10, axis=1)
    found = bootstrap(np.stack([runs, runs + 5]))
    assert found.value == pytest.approx(3.0)
    assert found.high - found.low == pytest.approx(2 * 1.96 * 0.112, abs=0.05)


@pytest.mark.parametrize("values", [[7.0], [[7.0]], [[[1.0]], [[2.0]]]])
def test_one_value_a_maze_has_no_interval(values: list[float]) -> None:
    found = bootstrap(values)
    assert math.isnan(found.low)
    assert math.isnan(found.high)


@pytest.mark.parametrize(
    ("shape", "of_one_run"),
    [((8,), False), ((1, 8), True), ((2, 8), False), ((3, 1, 8), True)],
)
def test_an_estimate_knows_whether_it_is_of_one_seed(
    shape: tuple[int, ...], of_one_run: bool
) -> None:
    values = np.random.default_rng(0).random(shape)
    assert bootstrap(values, draws=10).of_one_run == of_one_run


def test_runs_alike_differ_by_their_episodes_only() -> None:
    runs = np.tile([0.0, 1.0], (50, 8))  # 50 runs of the same 16 episodes
    # Standard error of 800 coin flips: 0.5 / sqrt(800) = 0.0177.
    found = bootstrap(runs, draws=2000)
    assert found.high - found.low == pytest.approx(2 * 1.96 * 0.0177, abs=0.01)


@given(
    arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(2, 5)), elements=FLOATS)
)
def test_an_interval_lies_within_the_values(values: np.ndarray) -> None:
    for statistic in (aggregate_iqm, np.median):
        found = bootstrap(values, statistic, draws=50)
        assert values.min() - 1e-9 <= found.low <= found.high <= values.max() + 1e-9


def test_a_seed_gives_one_interval() -> None:
    values = np.random.default_rng(0).random((3, 8))
    assert bootstrap(values, seed=4) == bootstrap(values, seed=4)
    assert bootstrap(values, seed=4) != bootstrap(values, seed=5)


def test_draws_leave_the_global_random_state() -> None:
    values = np.random.default_rng(0).random((3, 8))
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    first = bootstrap(values)
    assert (np.random.get_state()[1] == state).all()  # noqa: NPY002
    assert bootstrap(values) == first


def test_one_value_has_no_interval() -> None:
    found = bootstrap([[0.75]])
    assert found.value == 0.75
    assert np.isnan([found.low, found.high]).all()


def test_a_running_mean_looks_back_and_over_gaps() -> None:
    found = running_mean([NAN, 1.0, NAN, 4.0, 7.0, NAN, NAN, NAN], window=3)
    # none; 1; 1; (1 + 4) / 2; (4 + 7) / 2; (4 + 7) / 2; 7; none
    np.testing.assert_array_equal(found, [NAN, 1, 1, 2.5, 5.5, 5.5, 7, NAN])


@given(lists(), st.integers(1, 15))
def test_a_running_mean_is_the_mean_of_a_slice(values: np.ndarray, window: int) -> None:
    found = running_mean(values, window)
    last = len(values) - 1
    assert found[last] == pytest.approx(values[-window:].mean(), abs=1e-9)
    assert found[0] == pytest.approx(values[0])


def test_a_running_mean_of_nothing_is_nothing() -> None:
    assert running_mean([], window=3).shape == (0,)


def test_correlation_of_four_episodes() -> None:
    # x: -1.5, -0.5, 0.5, 1.5 around its mean; y: -2, 1, -1, 2.
    # sum of products 3 - 0.5 - 0.5 + 3 = 5; norms sqrt(5) and sqrt(10).
    found = correlation([1, 2, 3, 4], [3, 6, 4, 7])
    assert found == pytest.approx(5 / np.sqrt(50))


def test_a_reward_that_falls_as_coverage_rises_correlates_negatively() -> None:
    assert correlation([300, 340, 372], [0.5, 0.45, 0.4]) < -0.99


@pytest.mark.parametrize(
    ("first", "second"),
    [([1, 2], [1, 2]), ([1, 2, NAN, 4], [1, NAN, 3, 4]), ([5, 5, 5], [1, 2, 3])],
)
def test_too_few_pairs_or_a_constant_have_no_correlation(
    first: list[float], second: list[float]
) -> None:
    assert np.isnan(correlation(first, second))


def test_pairs_with_a_gap_are_left_out() -> None:
    assert correlation([1, 2, 3, NAN, 9], [2, 4, 6, 1, NAN]) == pytest.approx(1.0)


@given(arrays(np.float64, (8, 2), elements=st.integers(-50, 50)))
def test_correlation_does_not_depend_on_units(pairs: np.ndarray) -> None:
    x, y = pairs.T
    found = correlation(x, y)
    if np.isfinite(found):
        assert -1 <= found <= 1
        assert correlation(y, x) == pytest.approx(found)
        assert correlation(3 * x + 7, -y) == pytest.approx(-found, abs=1e-9)


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match=r"values must be .* got \(0,\)"):
        bootstrap([])
    with pytest.raises(ValueError, match=r"got \(1, 1, 1, 1\)"):
        bootstrap([[[[1.0]]]])
    with pytest.raises(ValueError, match="values must be finite"):
        bootstrap([1.0, NAN])
    with pytest.raises(ValueError, match=r"level must lie in .* got 95 and 2000"):
        bootstrap([1.0], level=95)
    with pytest.raises(ValueError, match=r"draws above 0, got 0\.95 and 0"):
        bootstrap([1.0], draws=0)
    with pytest.raises(ValueError, match="window must be at least 1, got 0"):
        running_mean([1.0], 0)
    with pytest.raises(ValueError, match="one length, got 2 and 3"):
        correlation([1, 2], [1, 2, 3])
