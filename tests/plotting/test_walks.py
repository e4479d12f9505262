from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PathCollection, QuadMesh
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from tests import episodes
from tests.fakes import MAZES, parse
from toponav.plotting import FloorPlan, draw_exploration, draw_leg
from toponav.plotting.walks import SPURIOUS, reward_limits

MASK, SLOTS = parse(MAZES["maze1"])
PLAN = FloorPlan(episodes.MASK, cell_size=128.0)


def drawn(**changed: object) -> tuple[Figure, Axes, Axes]:
    figure = draw_exploration(replace(episodes.trace(), **changed), PLAN)
    return figure, figure.axes[0], figure.axes[1]


def marks(axes: Axes) -> dict[str, list[list[float]]]:
    return {
        str(one.get_label()): np.asarray(one.get_offsets()).tolist()
        for one in axes.collections
        if isinstance(one, PathCollection)
    }


def test_waypoints_stand_where_they_were_seen() -> None:
    _, plan, _ = drawn()
    assert marks(plan) == {
        "waypoint": [[64.0, 64.0], [448.0, 64.0]],
        "spurious waypoint": [[320.0, 64.0]],
        "start": [[64.0, 64.0]],
        "end": [[448.0, 64.0]],
    }
    (red,) = (one for one in plan.collections if one.get_label() == "spurious waypoint")
    assert tuple(red.get_facecolor()[0][:3]) == to_rgb(SPURIOUS)
    legend = plan.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == list(marks(plan))


def test_the_trail_has_the_colours_of_the_reward() -> None:
    figure, plan, _ = drawn()
    lines = [one for one in plan.collections if isinstance(one, LineCollection)]
    values = lines[-1].get_array()
    assert values is not None
    assert np.asarray(values).tolist() == episodes.REWARD[1:]
    assert lines[-1].get_clim() == reward_limits(episodes.REWARD)
    # Of the task or of curiosity.
    label = "reward learned from (lightest: the highest 2 %)"
    assert figure.axes[2].get_ylabel() == label


def test_the_titles_say_what_the_numbers_are() -> None:
    _, plan, time = drawn()
    assert plan.get_title(loc="left") == (
        "4 decisions: coverage 80%, return 6.5;\n3 waypoints, 1 of 2 new ones spurious"
    )
    # Shares 1, 2, 1, 1 of 5: entropy 0.6 ln 5 + 0.4 ln 2.5 = 1.332, e^1.332 = 3.79.
    assert time.get_title(loc="left") == (
        "4 of 5 cells visited (hatched: never), time spread as over 4;\n"
        "the five busiest hold 100% of 5 observations"
    )


def test_without_a_topological_memory_nothing_speaks_of_waypoints() -> None:
    none = np.zeros(5, bool)
    _, plan, _ = drawn(is_new_waypoint=none, spurious_waypoint=none)
    assert plan.get_title(loc="left") == "4 decisions: coverage 80%, return 6.5"
    assert list(marks(plan)) == ["start", "end"]


def test_occupancy_is_the_share_of_the_time_and_never_is_hatched() -> None:
    figure, _, time = drawn()
    image = time.images[-1].get_array()
    assert image is not None
    np.testing.assert_allclose(np.ma.filled(image, -1), [[0.2, 0.4, 0.2, 0.2, -1]])
    (never,) = (one for one in time.collections if one.get_hatch())
    assert not isinstance(never, QuadMesh)  # it draws no hatches
    boxes = [path.get_extents() for path in never.get_paths()]
    assert [(box.x0, box.x1) for box in boxes] == [(512.0, 640.0)]
    assert figure.axes[3].get_ylabel() == "share of the time"


def test_rows_are_counted_from_the_top() -> None:
    # The second row from the top of two: it is drawn at the bottom, below y = 128.
    mask = episodes.MASK.repeat(2, 1)
    trace = replace(episodes.trace(), cells=np.array([[1, 0]] * 5))
    figure = draw_exploration(trace, FloorPlan(mask, cell_size=128.0))
    FigureCanvasAgg(figure).draw()
    image = figure.axes[1].images[-1]
    array, extent = image.get_array(), image.get_extent()
    assert array is not None
    assert not np.ma.getmaskarray(array)[1, 0]
    assert extent == [0.0, 640.0, 0.0, 256.0]
    assert image.origin == "upper"
    (never,) = (one for one in figure.axes[1].collections if one.get_hatch())
    boxes = [path.get_extents() for path in never.get_paths()]
    assert (0.0, 128.0) not in {(box.x0, box.y1) for box in boxes}
    assert len(boxes) == 9


@pytest.mark.parametrize(
    ("reward", "limits"),
    [
        ([0.0, 0.0, 0.0], (0.0, 1.0)),
        ([-1.0, 1.0, 1.0, 1.0], (-1.0, 1.0)),
        (list(range(101)), (0.0, 98.0)),
    ],
)
def test_the_highest_rewards_do_not_darken_the_others(
    reward: list[float], limits: tuple[float, float]
) -> None:
    assert reward_limits(reward) == pytest.approx(limits)


def leg(**arguments):
    waypoints = np.array([[192.0, 448], [448, 448], [1216, 448]])
    given = {
        "walked": [[192.0, 448], [320, 448], [448, 448]],
        "heading": 0.0,
        "plan": FloorPlan(MASK, cell_size=128.0, goal=(10, 12)),
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
        "edge cut on the path",
        "goal",
        "start",
    }
    planned, walked = axes.lines[-2:]
    assert planned.get_xdata().tolist() == [192, 448, 1216]
    assert walked.get_xdata().tolist() == [192, 320, 448]
    shut = next(c for c in axes.collections if c.get_label() == "edge cut on the path")
    assert shut.get_segments()[0].tolist() == [[448, 448], [1216, 448]]


def test_a_leg_without_cuts_or_plan_is_drawn_too():
    figure = leg(cuts=np.empty((0, 2)), planned=[], edges=np.empty((0, 2)))
    names = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert "edge cut on the path" not in names
