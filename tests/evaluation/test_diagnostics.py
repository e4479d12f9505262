import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from toponav.evaluation import (
    correlation,
    effective_cells,
    first_visits,
    occupancy,
    reward_by_new_cells,
)

NAN = float("nan")
FLOATS = st.floats(-100, 100)
CELLS = arrays(
    np.int64, st.tuples(st.integers(1, 60), st.just(2)), elements=st.integers(0, 4)
)


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


def test_reward_and_new_cells_over_windows() -> None:
    cells = [[1, 1], [1, 1], [1, 2], [1, 1], [1, 3], [1, 4], [1, 4]]
    sums, new = reward_by_new_cells([9, 1, 2, 3, 4, 5, 6], cells, window=3)
    assert sums.tolist() == [12, 12]  # 9 + 1 + 2 and 3 + 4 + 5; the rest is left out
    assert new.tolist() == [1, 2]  # (1, 2); then (1, 3) and (1, 4); not the start


@given(CELLS)
def test_windows_of_one_give_every_first_visit_but_the_start(cells: np.ndarray) -> None:
    _, new = reward_by_new_cells(np.zeros(len(cells)), cells, window=1)
    different = len({tuple(cell) for cell in cells})
    assert new.sum() == different - 1
    assert first_visits(cells).sum() == different


@given(CELLS)
def test_occupancy_counts_every_observation(cells: np.ndarray) -> None:
    share = occupancy(cells, (5, 6))
    assert share.shape == (5, 6)
    assert share.sum() == pytest.approx(1)
    for row, column in cells:
        here = (cells == [row, column]).all(1).mean()
        assert share[row, column] == pytest.approx(here)


@given(st.integers(1, 30))
def test_equal_shares_count_all_their_cells(number: int) -> None:
    assert effective_cells(np.full(number, 1 / number)) == pytest.approx(number)


def test_unequal_shares_count_fewer_cells() -> None:
    # Entropy of 3/4, 1/4: 0.75 ln(4/3) + 0.25 ln 4 = 0.5623; e^0.5623 = 1.7548.
    assert effective_cells([[0.75, 0.0], [0.0, 0.25]]) == pytest.approx(
        1.7548, abs=1e-4
    )


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="one length, got 2 and 3"):
        correlation([1, 2], [1, 2, 3])
    with pytest.raises(ValueError, match="reward must be as long as cells, 1, got 2"):
        reward_by_new_cells([1, 2], [[1, 1]])
    with pytest.raises(ValueError, match="window must be at least 1, got 0"):
        reward_by_new_cells([1], [[1, 1]], window=0)
    with pytest.raises(ValueError, match="at least one entry"):
        occupancy(np.empty((0, 2)), (3, 3))
    with pytest.raises(
        ValueError, match=r"layout of \(3, 3\), got \[0, 1\] to \[3, 1\]"
    ):
        occupancy([[0, 1], [3, 1]], (3, 3))
