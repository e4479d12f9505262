from functools import partial

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from tests.fakes import MAZES, parse
from toponav.evaluation import draw_leg, draw_plan, draw_success, navigated_frames

MASK, SLOTS = parse(MAZES["maze1"])


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
    assert axes.get_legend().get_texts()[0].get_text() == "ours 75 %"
    assert axes.get_xlabel() == "decisions since the episode began"


def leg(**arguments):
    waypoints = np.array([[192.0, 448], [448, 448], [1216, 448]])
    given = {
        "walked": [[192.0, 448], [320, 448], [448, 448]],
        "heading": 0.0,
        "draw": partial(draw_plan, open_mask=MASK, goal=(10, 12)),
        "waypoints": waypoints,
        "edges": [[0, 1], [1, 2]],
        "planned": [0, 1, 2],
        "cuts": [[1, 2]],
    }
    return draw_leg(**(given | arguments))


def test_a_leg_shows_map_plan_walk_and_cuts():
    figure = leg(title="one")
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    names = {text.get_text() for text in axes.get_legend().get_texts()}
    assert names == {
        "edge",
        "waypoint",
        "first plan",
        "walked",
        "closed on the way",
        "goal",
        "start",
    }
    planned, walked = axes.lines[-2:]
    assert planned.get_xdata().tolist() == [192, 448, 1216]
    assert walked.get_xdata().tolist() == [192, 320, 448]
    shut = next(c for c in axes.collections if c.get_label() == "closed on the way")
    assert shut.get_segments()[0].tolist() == [[448, 448], [1216, 448]]


def test_a_leg_without_cuts_or_plan_is_drawn_too():
    figure = leg(cuts=np.empty((0, 2)), planned=[], edges=np.empty((0, 2)))
    names = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert "closed on the way" not in names


def frames(**arguments):
    view = np.full((120, 160, 3), 40, np.uint8)
    target = np.full((60, 80, 3), (200, 0, 0), np.uint8)
    given = {
        "positions": [[192.0, 448], [225, 448]],
        "headings": [0.0, 0.0],
        "views": [view, view],
        "targets": [target, None],
        "goal": np.full((60, 80, 3), (0, 0, 200), np.uint8),
        "draw": partial(draw_plan, open_mask=MASK),
        "captions": ["decision 0", "decision 1"],
        "height": 200,
    }
    return list(navigated_frames(**(given | arguments)))


def test_a_frame_has_view_target_goal_and_plan_side_by_side():
    first, second = frames()
    # The view is 200 * 4 / 3 = 267 wide; then 8 white, and two pictures of 96 high and
    # 128 wide, one above the other; then 8 white and the plan.
    assert first.shape == second.shape
    assert first.shape[0] == 200 + 22
    assert (first[100, 100] == 40).all()
    assert (first[100, 270] == 255).all()
    assert (first[60, 330] == [200, 0, 0]).all()
    assert (second[60, 330] == 160).all()  # lost: nothing to walk to
    assert (first[160, 330] == [0, 0, 200]).all()
    assert (first[202:] != 255).any()
    assert (first[:200, 420:] != second[:200, 420:]).any()


@pytest.mark.parametrize("name", ["views", "targets", "captions"])
def test_all_must_be_as_many(name):
    few = {"views": [np.zeros((120, 160, 3))], "targets": [None], "captions": ["one"]}
    with pytest.raises(ValueError, match=r"shorter|longer"):
        frames(**{name: few[name]})
