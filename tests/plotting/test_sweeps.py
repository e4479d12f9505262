import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from toponav.plotting import draw_learning_curves, draw_sweep
from toponav.plotting.sweeps import Runs, band

NAN = float("nan")


def group(*runs: tuple[list[float], list[float]]) -> Runs:
    return [(np.array(x), np.array(y)) for x, y in runs]


def swept(panels: dict, *, x: str) -> Figure:
    """Panel to line to points, a point being a setting and its values."""
    rows = [
        (panel, line, at, value)
        for panel, lines in panels.items()
        for line, points in lines.items()
        for at, values in points
        for value in values
    ]
    values = pd.DataFrame(rows, columns=["panel", "line", "at", "value"])
    return draw_sweep(values, x=x, label="%")


def labels(axes: Axes) -> list[str]:
    return [str(line.get_label()) for line in axes.lines]


def test_a_band_is_where_all_runs_have_been() -> None:
    first = ([0.0, 100.0], [10.0, 30.0])
    second = ([50.0, 75.0, 100.0, 200.0], [40.0, NAN, 60.0, 80.0])
    x, mean, low, high = band(group(first, second))
    assert (x[0], x[-1]) == (50, 100)
    # At 50: 20 and 40; at 100: 30 and 60; the gap is bridged.
    assert (mean[0], low[0], high[0]) == (30, 20, 40)
    assert (mean[-1], low[-1], high[-1]) == (45, 30, 60)


def test_a_band_keeps_the_decisions_that_runs_share() -> None:
    x, mean, _, _ = band(group(([1, 10, 100], [0, 20, 40]), ([1, 10, 100], [2, 4, 6])))
    assert (x.tolist(), mean.tolist()) == ([1, 10, 100], [1, 12, 23])


def test_no_two_of_many_groups_look_alike() -> None:
    line = group(([0.0, 9.0], [40.0, 60.0]))
    panels = {"maze1": {str(number): line for number in range(10)}}
    (axes,) = draw_learning_curves(panels, {}, label="%").axes
    looks = {(line.get_color(), line.get_linestyle()) for line in axes.lines}
    assert len(looks) == 10


def test_a_logarithmic_axis_of_decisions() -> None:
    panels = {"maze1": {"a": group(([10.0, 5000.0], [40.0, 60.0]))}}
    (axes,) = draw_learning_curves(panels, {}, label="%", log_x=True).axes
    axes.figure.canvas.draw()
    assert axes.get_xscale() == "log"
    shown = [text.get_text() for text in axes.get_xticklabels()]
    assert {"10", "100", "1 k"} <= set(shown)


def test_a_measure_that_is_no_percentage_is_shown_whole() -> None:
    panels = {"pong": {"a": group(([0.0, 9.0], [-5.0, 300.0]))}}
    (axes,) = draw_learning_curves(panels, {}, label="return", percent=False).axes
    low, high = axes.get_ylim()
    assert low <= -5 < 300 <= high
    (axes,) = draw_learning_curves(panels, {}, label="%").axes
    assert axes.get_ylim() == (0, 102)


def test_runs_of_which_nothing_is_drawn_are_not_counted() -> None:
    runs = group(([0.0, 9.0], [40.0, 60.0]), ([0.0, 9.0], [NAN, NAN]))
    (axes,) = draw_learning_curves({"maze1": {"a": runs}}, {}, label="%").axes
    assert labels(axes) == ["a (1 run)"]


@pytest.mark.parametrize(
    "runs",
    [[], [([1.0], [NAN])], [([0.0, 1.0], [5.0, 5.0]), ([2.0, 3.0], [5.0, 5.0])]],
)
def test_runs_without_a_common_part_have_no_band(runs: list) -> None:
    assert [len(part) for part in band(group(*runs))] == [0, 0, 0, 0]


def test_each_panel_has_its_groups_and_its_levels() -> None:
    line = ([0.0, 9.0], [40.0, 60.0])
    figure = draw_learning_curves(
        {
            "maze1": {"a": group(line, line), "b": group(line)},
            "maze3": {"a": group(line)},
        },
        {"maze1": {"uniform random": 53.0, "sticky random": 67.64}},
        label="coverage (%)",
        title="explore",
    )
    one, three = figure.axes
    assert labels(one) == [
        *["a (2 runs)", "b (1 run)", "uniform random 53.0", "sticky random 67.6"]
    ]
    assert labels(three) == ["a (1 run)"]
    assert one.lines[2].get_ydata() == [53.0, 53.0]
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["maze1", "maze3"]
    assert one.get_ylabel() == "coverage (%)"


def test_accuracies_over_numbers_have_dots_and_a_line() -> None:
    points = [("1", [80.0, 90.0]), ("4", [92.0, 94.0])]
    figure = swept({"select": {"TC": points, "L": [("4", [70.0])]}}, x="pairs.k")
    (axes,) = figure.axes
    tc, locomotion = axes.lines
    assert (tc.get_xdata().tolist(), tc.get_ydata().tolist()) == ([1, 4], [85, 93])
    assert tc.get_linestyle() == "-"
    assert labels(axes) == ["TC, mean of 2 runs", "L, mean of 1 run"]
    dots = [one.get_offsets().tolist() for one in axes.collections]
    assert dots == [[[1, 80], [1, 90], [4, 92], [4, 94]]]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["1", "4"]
    assert axes.get_xscale() == "linear"
    assert locomotion.get_xdata().tolist() == [4]


def test_a_line_says_of_how_few_runs_its_means_are() -> None:
    points = [("1", [80.0]), ("4", [92.0, 94.0, 96.0])]
    (axes,) = swept({"": {"TC": points}}, x="k").axes
    assert labels(axes) == ["TC, mean of 1 to 3 runs"]


def test_names_stand_side_by_side_without_a_line() -> None:
    points = [("maze1", [80.0]), ("maze2", [82.0])]
    (axes,) = swept({"": {"TC": points}}, x="maze").axes
    assert axes.lines[0].get_linestyle() == "None"
    assert axes.lines[0].get_xdata().tolist() == [0, 1]


def test_a_wide_range_is_logarithmic() -> None:
    points = [("300000", [80.0]), ("5000000", [91.0])]
    (axes,) = swept({"": {"TC": points}}, x="volume").axes
    assert axes.get_xscale() == "log"


def test_panels_share_their_scale() -> None:
    low, high = {"TC": [("1", [20.0])]}, {"TC": [("1", [90.0])]}
    one, two = swept({"a": low, "b": high}, x="k").axes
    assert one.get_ylim() == two.get_ylim()


@pytest.mark.parametrize("name", ["novelty", "pretrained runs/pretrain/maze2-" * 9])
def test_a_panel_keeps_its_width_beside_long_names(name: str) -> None:
    runs = group(([0.0, 100.0], [10.0, 30.0]))
    figure = draw_learning_curves(
        {"": {f"{name} 1": runs, f"{name} 2": runs}}, {}, label="coverage (%)"
    )
    figure.canvas.draw()
    (axes,) = figure.axes
    assert axes.get_position().width > 0.6
    legend = axes.get_legend()
    assert legend is not None
    # All names are there, and inside of the figure.
    said = ["".join(text.get_text().split()) for text in legend.get_texts()]
    want = [f"{name}{number}(1 run)".replace(" ", "") for number in (1, 2)]
    assert said == want
    assert legend.get_window_extent().x1 <= figure.bbox.x1
