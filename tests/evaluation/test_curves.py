import pytest

from toponav.evaluation import draw_curves

HISTORY = [{"update": 10, "a": 0.5, "b": 1.0}, {"update": 20, "a": 0.75, "c": 0.1}]


def test_each_panel_shows_its_names_over_the_updates() -> None:
    figure = draw_curves(HISTORY, panels={"One": ["a"], "Two": ["c", "a"]}, x="update")
    one, two = figure.axes
    (line,) = one.lines
    assert line.get_xdata().tolist() == [10, 20]
    assert line.get_ydata().tolist() == [0.5, 0.75]
    assert [line.get_label() for line in two.lines] == ["c 0.100", "a 0.750"]
    assert two.lines[0].get_xdata().tolist() == [20]


@pytest.mark.parametrize("history", [[], HISTORY])
def test_names_that_were_not_measured_are_left_out(history: list) -> None:
    figure = draw_curves(history, panels={"One": ["missing"]}, x="update")
    assert not figure.axes[0].lines
