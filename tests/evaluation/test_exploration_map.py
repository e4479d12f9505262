from functools import partial

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PathCollection, QuadMesh
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from tests.evaluation import episodes
from toponav.evaluation import draw_exploration, draw_plan
from toponav.evaluation.exploration_map import FALSE_WAYPOINT, reward_limits

PLAN = partial(draw_plan, open_mask=episodes.MASK)


def drawn(**more: object) -> tuple[Figure, Axes, Axes]:
    figure = draw_exploration(episodes.trace(), episodes.MASK, draw=PLAN, **more)
    return figure, figure.axes[0], figure.axes[1]


def marks(axes: Axes) -> dict[str, list[list[float]]]:
    return {
        str(one.get_label()): np.asarray(one.get_offsets()).tolist()
        for one in axes.collections
        if isinstance(one, PathCollection)
    }


def test_waypoints_stand_where_they_were_born() -> None:
    _, plan, _ = drawn()
    assert marks(plan) == {
        "waypoint": [[64.0, 64.0], [448.0, 64.0]],
        "false birth": [[320.0, 64.0]],
        "start": [[64.0, 64.0]],
        "end": [[448.0, 64.0]],
    }
    (false,) = (one for one in plan.collections if one.get_label() == "false birth")
    assert tuple(false.get_facecolor()[0][:3]) == to_rgb(FALSE_WAYPOINT)
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
    assert "intrinsic reward" in figure.axes[2].get_ylabel()


def test_the_titles_say_what_the_numbers_are() -> None:
    figure, plan, time = drawn(title="maze3")
    assert plan.get_title(loc="left") == (
        "4 decisions: coverage 80%, return 6.5;\n3 waypoints, 1 of 2 births false"
    )
    # Shares 1, 2, 1, 1 of 5: entropy 0.6 ln 5 + 0.4 ln 2.5 = 1.332, e^1.332 = 3.79.
    assert time.get_title(loc="left") == (
        "4 of 5 cells visited (hatched: never), time spread as over 4;\n"
        "the five busiest hold 100% of 5 observations"
    )
    assert figure.get_suptitle() == "maze3"


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
    figure = draw_exploration(
        episodes.trace(),
        mask,
        draw=partial(draw_plan, open_mask=mask),
        visited=[[1, 0]],
    )
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


def test_cells_of_many_episodes_can_be_shown() -> None:
    _, _, time = drawn(visited=[[0, 4], [0, 4], [0, 0], [0, 4]])
    image = time.images[-1].get_array()
    assert image is not None
    np.testing.assert_allclose(np.ma.filled(image, 0), [[0.25, 0, 0, 0, 0.75]])


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
