import torch
from hypothesis import given, strategies as st

from toponav.graph.growing_rows import GrowingRows


@given(st.integers(0, 5), st.integers(0, 40))
def test_rows_are_those_that_cat_makes(first, more):
    rows = torch.randn(first, 3)
    grown, expected = GrowingRows(rows.clone()), rows
    for row in torch.randn(more, 3):
        grown.append(row)
        expected = torch.cat([expected, row.unsqueeze(0)])
    assert torch.equal(grown.rows, expected)


def test_what_was_read_stays_as_it_was():
    grown = GrowingRows(torch.zeros(0))
    grown.append(torch.ones(2))
    before = grown.rows
    for _ in range(9):
        grown.append(torch.zeros(2))
    assert before.tolist() == [[1.0, 1.0]]


def test_memory_is_taken_seldom():
    grown = GrowingRows(torch.zeros(1, 2))
    places = set()
    for _ in range(99):
        grown.append(torch.zeros(2))
        places.add(grown.rows.data_ptr())
    # For 2, 4, 8, 16, 32, 64 and 128 rows.
    assert len(places) <= 7
