import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from toponav.metrics import effective_cells, occupancy

CELLS = arrays(
    np.int64, st.tuples(st.integers(1, 60), st.just(2)), elements=st.integers(0, 4)
)


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
    with pytest.raises(ValueError, match="at least one entry"):
        occupancy(np.empty((0, 2)), (3, 3))
    with pytest.raises(
        ValueError, match=r"layout of \(3, 3\), got \[0, 1\] to \[3, 1\]"
    ):
        occupancy([[0, 1], [3, 1]], (3, 3))
