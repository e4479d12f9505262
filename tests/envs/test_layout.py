"""The geometry of a valid layout."""

import pickle

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

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
    assert HALL.centre((1, 3), 128) == (448.0, 448.0)
    assert HALL.centre((3, 1), 128) == (192.0, 192.0)


def test_a_cell_holds_its_west_and_south_edge() -> None:
    # x = 256 is the border between columns 1 and 2, y = 256 between rows 3 and 2.
    assert HALL.cell_of(255.9, 255.9, 128) == (3, 1)
    assert HALL.cell_of(256.0, 256.0, 128) == (2, 2)


@settings(max_examples=50, deadline=None)
@given(layout=ANY_LAYOUT, data=st.data())
def test_cell_and_centre_are_inverse(layout: Layout, data: st.DataObject) -> None:
    size = data.draw(st.sampled_from([1, 100, 128]))
    offset = data.draw(st.tuples(*[st.floats(-0.499, 0.499)] * 2))
    places = [layout.centre(cell, size) for cell in layout.cells]
    x, y = (np.array(places) + np.array(offset) * size).T
    assert [layout.cell_of(*place, size) for place in zip(x, y, strict=True)] == list(
        layout.cells
    )


@settings(max_examples=60, deadline=None)
@given(layout=ANY_LAYOUT, data=st.data())
def test_the_graph_has_the_steps_between_open_cells(
    layout: Layout, data: st.DataObject
) -> None:
    source = data.draw(st.sampled_from(layout.cells))
    lengths = nx.single_source_shortest_path_length(layout.graph(), source)
    # In one piece: whatever is open can be reached.
    assert lengths == steps_from(layout, source)
    assert len(lengths) == layout.num_cells


class TestBadArguments:
    def test_an_unknown_slot_is_refused_with_those_there_are(self) -> None:
        with pytest.raises(ValueError, match=r"slots of gate \(a\), got 'q'"):
            GATE.check_slots("q")
        with pytest.raises(ValueError, match=r"slots of lane \(none\), got 'a'"):
            LANE.check_slots("a")

    def test_slots_that_cut_together_are_refused(self) -> None:
        # Either slot of the ring may close; both cut north from south.
        assert RING.check_slots("a") == ("a",)
        assert RING.check_slots(["b", "b"]) == ("b",)
        with pytest.raises(ValueError, match="ring in one piece, got a, b together"):
            RING.check_slots("ba")


def test_equal_layouts_are_one_key_of_a_dictionary() -> None:
    copy = pickle.loads(pickle.dumps(RING))
    assert copy == RING
    assert len({copy: 0, RING: 1}) == 1
    assert Layout(RING.text, name="other") != RING


def test_a_layout_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        RING.text = LANE.text  # type: ignore[misc]
