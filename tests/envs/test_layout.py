"""The geometry of a valid layout."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.envs.layouts import (
    GATE,
    HALL,
    LANE,
    RING,
    drawn_layouts,
    random_layouts,
    steps_from,
)
from toponav.envs import Layout

ANY_LAYOUT = random_layouts() | drawn_layouts()


def test_cells_are_in_reading_order() -> None:
    assert LANE.cells == ((1, 1), (1, 2), (1, 3))
    assert RING.num_cells == 8
    assert RING.shape == (5, 5)


def test_slots_are_in_the_order_of_the_alphabet() -> None:
    layout = Layout("*****\n*z  *\n*   *\n*  b*\n*****")
    assert list(layout.slots.items()) == [("b", (3, 3)), ("z", (1, 1))]


def test_positions_are_measured_from_the_south_west_corner() -> None:
    # Row 1 of 5 is the fourth from the south: y = 3.5 x 128; column 3: x = 3.5 x 128.
    assert HALL.centre((1, 3)) == (448.0, 448.0)
    assert HALL.centre((3, 1)) == (192.0, 192.0)


def test_a_cell_holds_its_west_and_south_edge() -> None:
    # x = 256 is the border between columns 1 and 2, y = 256 between rows 3 and 2.
    assert HALL.cell_of(255.9, 255.9) == (3, 1)
    assert HALL.cell_of(256.0, 256.0) == (2, 2)


@settings(max_examples=50, deadline=None)
@given(layout=ANY_LAYOUT, data=st.data())
def test_cell_and_centre_are_inverse(layout: Layout, data: st.DataObject) -> None:
    offset = data.draw(st.tuples(*[st.floats(-63.9, 63.9)] * 2))
    places = [layout.centre(cell) for cell in layout.cells]
    x, y = (np.array(places) + offset).T
    assert [layout.cell_of(*place) for place in zip(x, y, strict=True)] == list(
        layout.cells
    )
    np.testing.assert_array_equal(layout.cells_of(x, y), layout.cells)


def test_distances_are_geodesic() -> None:
    # Around the ring of eight: 4 to the opposite cell, 3 + 3 with a slot closed.
    assert RING.distances((1, 2))[3, 2] == 4
    assert RING.distances((1, 2))[0, 0] == -1
    assert RING.distances((1, 1), closed="a")[3, 1] == 6
    assert RING.distances((1, 1), closed="a")[2, 1] == -1


@settings(max_examples=60, deadline=None)
@given(layout=ANY_LAYOUT, data=st.data())
def test_distances_agree_with_breadth_first_search(
    layout: Layout, data: st.DataObject
) -> None:
    closed = data.draw(st.sampled_from(["", *layout.slots]))
    graph = layout.graph(closed)
    source = data.draw(st.sampled_from(sorted(graph)))
    expected = np.full(layout.shape, -1)
    for cell, steps in steps_from(layout, source, closed).items():
        expected[cell] = steps
    np.testing.assert_array_equal(layout.distances(source, closed), expected)
    # In one piece: whatever is open can be reached.
    assert (expected >= 0).sum() == layout.num_cells - len(closed)


@settings(max_examples=60, deadline=None)
@given(layout=ANY_LAYOUT, data=st.data())
def test_distances_are_a_metric(layout: Layout, data: st.DataObject) -> None:
    a, b, c = (data.draw(st.sampled_from(layout.cells)) for _ in range(3))
    from_a, from_b = layout.distances(a), layout.distances(b)
    assert from_a[b] == from_b[a]
    assert from_a[c] <= from_a[b] + from_b[c]
    assert from_a[b] >= abs(a[0] - b[0]) + abs(a[1] - b[1])


class TestBadArguments:
    def test_an_unknown_slot_is_told_which_there_are(self) -> None:
        with pytest.raises(ValueError, match=r"slots of gate \(a\), got 'q'"):
            GATE.check_slots("q")
        with pytest.raises(ValueError, match=r"slots of lane \(none\), got 'a'"):
            LANE.graph("a")

    def test_slots_that_cut_together_are_refused(self) -> None:
        # Either slot of the ring may close; both cut north from south.
        assert RING.check_slots("a") == ("a",)
        assert RING.check_slots(["b", "b"]) == ("b",)
        with pytest.raises(ValueError, match="ring in one piece, got a, b together"):
            RING.check_slots("ba")

    @pytest.mark.parametrize("source", [(0, 0), (2, 1), (9, 9)])
    def test_distances_start_at_an_open_cell(self, source: tuple[int, int]) -> None:
        with pytest.raises(ValueError, match=r"source must be an open cell, got \("):
            RING.distances(source, closed="a")


def test_equal_layouts_are_one_key_of_a_dictionary() -> None:
    copy = pickle.loads(pickle.dumps(RING))
    assert copy == RING
    assert len({copy: 0, RING: 1}) == 1
    assert Layout(RING.text, name="other") != RING


def test_a_layout_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        RING.text = LANE.text  # type: ignore[misc]
