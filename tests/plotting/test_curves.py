import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

from toponav.plotting import draw_curves, draw_success, draw_training

NAN = float("nan")
LEVELS = {"uniform random": 0.42, "sticky random": 0.54}
EPISODES = {
    "decisions": [100.0, 200.0, 300.0, 400.0],
    "coverage": [0.2, 0.4, NAN, 0.6],
    "intrinsic_return": [10.0, 20.0, 25.0, 30.0],
    "count_return": [1.0, 2.0, 3.0, 4.0],
    "new_waypoints": [8.0, 4.0, 6.0, 2.0],
    "spurious_waypoints": [2.0, 2.0, 0.0, 0.0],
}
METRICS = {
    "decisions": [128.0, 256.0, 500.0],
    "entropy": [1.7, NAN, 1.5],
    "loss_tc": [NAN, NAN, NAN],
}
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


def lines(axes: Axes) -> dict[str, tuple[list[float], list[float]]]:
    return {
        str(line.get_label()): (
            np.asarray(line.get_xdata()).tolist(),
            np.asarray(line.get_ydata()).tolist(),
        )
        for line in axes.lines
    }


def test_coverage_has_dots_a_mean_and_the_levels() -> None:
    figure = draw_training(EPISODES, METRICS, levels=LEVELS, window=2)
    found = lines(figure.axes[0])
    assert list(found) == [
        "episodes",
        "mean of the last 2 (fewer at first)",
        "uniform random 42%",
        "sticky random 54%",
    ]
    x, y = found["mean of the last 2 (fewer at first)"]
    assert x == EPISODES["decisions"]
    assert y == pytest.approx([0.2, 0.3, 0.4, 0.6])  # over the gap
    assert found["uniform random 42%"][1] == [0.42, 0.42]
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == list(found)


def test_the_return_names_its_parts_and_its_correlation_with_coverage() -> None:
    axes = draw_training(EPISODES, {}, levels={}, window=2).axes[1]
    mean = "mean of the last 2 (fewer at first)"
    assert list(lines(axes)) == ["episodes", mean, "count part"]
    # Coverage 0.2, 0.4, 0.6 with returns 10, 20, 30; the third has none.
    assert axes.get_title(loc="left").endswith("(correlation with coverage 1.00)")


def test_new_networks_are_marked_where_the_learner_first_had_them() -> None:
    metrics = METRICS | {"networks_version": [0.0, 1.0, 1.0]}
    axes = draw_training(EPISODES, metrics, levels={}, window=2).axes[1]
    assert lines(axes)["new networks"][0] == [256.0, 256.0]


def test_small_panels_show_the_learner_with_gaps_left_out() -> None:
    axes = draw_training(EPISODES, METRICS, levels={}, window=2).axes
    panels = {one.get_title(loc="left"): lines(one) for one in axes[2:]}
    assert panels["Waypoints per episode"] == {
        "new 4": (EPISODES["decisions"], [8.0, 6.0, 5.0, 4.0]),
        "of them spurious 0": (EPISODES["decisions"], [2.0, 2.0, 1.0, 0.0]),
    }
    assert panels["Entropy of the policy"] == {
        "entropy 1.5": ([128.0, 500.0], [1.7, 1.5])
    }
    assert panels["Losses of the networks"] == {}


def test_all_panels_share_the_decisions_up_to_the_last() -> None:
    figure = draw_training(EPISODES, METRICS, levels=LEVELS)
    assert {axes.get_xlim() for axes in figure.axes} == {(0.0, 510.0)}


@pytest.mark.parametrize("episodes", [{}, {"decisions": [], "coverage": []}])
def test_a_run_that_has_just_begun_shows_the_levels_alone(
    episodes: dict[str, list[float]],
) -> None:
    figure = draw_training(episodes, {}, levels=LEVELS, title="maze3")
    FigureCanvasAgg(figure).draw()
    assert list(lines(figure.axes[0])) == ["uniform random 42%", "sticky random 54%"]
    texts = [[text.get_text() for text in axes.texts] for axes in figure.axes]
    episodes_first = ["no whole episode has ended yet"]
    assert texts == [[], *[episodes_first] * 2, *[["nothing measured so far"]] * 3]
    assert figure.get_suptitle() == "maze3"


def test_a_run_without_a_whole_episode_shows_those_that_run_and_says_so() -> None:
    metrics = METRICS | {"running_coverage": [0.1, 0.2, 0.3]}
    metrics |= {"running_waypoints": [2.0, 3.0, 5.0]}
    figure = draw_training([], metrics, levels={})
    coverage, paid, waypoints, *_ = figure.axes
    assert lines(waypoints) == {
        "running episodes so far": (METRICS["decisions"], [2.0, 3.0, 5.0])
    }
    assert lines(coverage) == {
        "running episodes so far": (METRICS["decisions"], [0.1, 0.2, 0.3])
    }
    assert [text.get_text() for text in coverage.texts] == []
    said = [text.get_text() for text in paid.texts]
    assert said == ["no whole episode has ended yet"]


def test_success_curves_rise_where_goals_were_reached():
    figure = draw_success({"ours": [10, 30, -1, 30]}, decisions=40, title="maze1")
    (axes,) = figure.axes
    (line,) = axes.lines
    times, share = line.get_data()
    # One of four at 10, three at 30.
    assert [share[list(times).index(at)] for at in (9, 10, 29, 30, 40)] == [
        0,
        0.25,
        0.25,
        0.75,
        0.75,
    ]
    assert axes.get_legend().get_texts()[0].get_text() == "ours 75%"
    assert axes.get_xlabel() == "decisions since the start of the episode"


def test_a_world_without_ground_truth_has_no_panels_for_it() -> None:
    unknown = ("coverage", "spurious_waypoints")
    episodes = {name: x for name, x in EPISODES.items() if name not in unknown}
    metrics = {name: x for name, x in METRICS.items() if name != "loss_tc"}
    figure = draw_training(episodes, metrics | {"loss_q": [3.0, 2.0, 1.0]}, levels={})
    FigureCanvasAgg(figure).draw()
    panels = {one.get_title(loc="left"): list(lines(one)) for one in figure.axes}
    mean = "mean of the last 16 (fewer at first)"
    assert panels == {
        # Of the task or of curiosity.
        "Return of the training's episodes": ["episodes", mean, "count part"],
        "Waypoints per episode": ["new 5"],
        "Entropy of the policy": ["entropy 1.5"],
        "Losses of the policy": ["q 1"],
    }
