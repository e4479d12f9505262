import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex

from tests.fakes import MAZES, parse
from toponav.plotting import FloorPlan, contact_sheet, spread_out

MASK, _ = parse(MAZES["maze3"])
PLAN = FloorPlan(MASK, cell_size=128.0)


def sheet_of(count, **arguments):
    views = np.full((count, 120, 160, 3), 90, np.uint8)
    places = np.linspace([200, 200], [1000, 200], count)
    return contact_sheet(views, places, np.zeros(count), plan=PLAN, **arguments)


def test_every_view_has_the_colour_and_number_of_its_mark():
    plan, *views = sheet_of(8).axes
    discs = [to_hex(c.get_facecolor()[0]) for c in plan.collections]
    frames = [to_hex(view.spines["left"].get_edgecolor()) for view in views]
    assert discs == frames
    assert len(set(frames)) == 8
    numbers = [text.get_text() for text in plan.texts if text.get_text()]
    assert numbers == [view.texts[0].get_text() for view in views]


def test_marks_stand_where_the_views_were_taken():
    plan = sheet_of(3).axes[0]
    places = [c.get_offsets()[0].tolist() for c in plan.collections]
    assert places == [[200, 200], [600, 200], [1000, 200]]


@pytest.mark.parametrize(("count", "columns"), [(1, 4), (5, 4), (4, 1), (6, 2)])
def test_any_number_of_views_fits(count, columns):
    figure = sheet_of(count, columns=columns)
    FigureCanvasAgg(figure).draw()
    assert len(figure.axes) == count + 1


def test_wrong_numbers_are_refused():
    views = np.zeros((2, 4, 4, 3), np.uint8)
    with pytest.raises(ValueError, match="as many and at least one, got 2, 3 and 2"):
        contact_sheet(views, np.zeros((3, 2)), np.zeros(2), plan=PLAN)
    with pytest.raises(ValueError, match="got 0, 0 and 0"):
        contact_sheet(views[:0], np.zeros((0, 2)), np.zeros(0), plan=PLAN)


def test_moments_are_far_apart_in_place_or_heading():
    places, headings = np.zeros((4, 2)), [0.0, 10.0, 180.0, 90.0]
    assert spread_out(places, headings, 2, cell_size=128.0).tolist() == [0, 2]
    # The third moment is 300 units away, turning around counts like two cells.
    places[1] = [300, 0]
    assert spread_out(places, headings, 2, cell_size=128.0).tolist() == [0, 1]
    assert spread_out(places, headings, 2, cell_size=200.0).tolist() == [0, 2]
    with pytest.raises(ValueError, match=r"count must lie in \[1, 4\], got 5"):
        spread_out(places, headings, 5, cell_size=128.0)
