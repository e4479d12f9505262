import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from matplotlib.colors import to_rgb

from tests import episodes
from tests.fakes import MAZES, parse
from toponav.metrics import EpisodeTrace
from toponav.plotting import FloorPlan, explored_frames, navigated_frames
from toponav.plotting.video import caption
from toponav.plotting.walks import SPURIOUS

MASK, _ = parse(MAZES["maze1"])
PLAN = FloorPlan(episodes.MASK, cell_size=128.0)
VIEWS = np.random.default_rng(0).integers(0, 256, (5, 60, 80, 3), np.uint8)


def frames(views: np.ndarray, every: int) -> list[np.ndarray]:
    shown = explored_frames(episodes.trace(), views, plan=PLAN, every=every, height=120)
    return list(shown)


def count_of(frame: np.ndarray, colour: str) -> int:
    wanted = np.asarray(to_rgb(colour)) * 255
    return int((np.abs(frame.astype(float) - wanted).max(-1) < 30).sum())


def test_each_frame_has_view_plan_and_strip() -> None:
    found = frames(VIEWS, 1)
    assert len(found) == 5
    assert {frame.shape for frame in found} == {(120 + 26, 160 + 8 + 240, 3)}
    for frame, view in zip(found, VIEWS, strict=True):
        assert (frame[:120:2, :160:2] == view).all()
    strips = [frame[120:] for frame in found]
    assert not (strips[0] == strips[1]).all()


def test_a_spurious_waypoint_appears_when_it_is_new_and_stays() -> None:
    # New with the third observation; the red dot is under the arrow at first.
    red = [count_of(frame[:120, 168:], SPURIOUS) for frame in frames(VIEWS, 1)]
    assert red[0] == red[1] == 0
    assert min(red[3:]) > 5


def test_skipped_decisions_leave_their_trail_and_their_waypoints() -> None:
    shown = frames(VIEWS[::2], 2)
    assert len(shown) == 3
    all_of_them = frames(VIEWS, 1)
    for few, one in zip(shown, all_of_them[::2], strict=True):
        assert (few[:120] == one[:120]).all()


def test_the_caption_counts_up_to_its_frame() -> None:
    assert caption(episodes.trace(), 3, since=1) == [
        "decision 3 of 4",
        "coverage 60%",
        "reward +2.50",  # 2 + 0.5, of the two decisions since
        "return 3.5",
        "waypoints 2 (1 spurious)",
    ]
    assert caption(episodes.trace(), 0, since=-1)[2:] == [
        "reward +0.00",
        "return 0.0",
        "waypoints 1 (0 spurious)",
    ]


def test_without_a_topological_memory_the_caption_has_no_waypoints() -> None:
    none = np.zeros(5, bool)
    trace = replace(episodes.trace(), is_new_waypoint=none, spurious_waypoint=none)
    assert caption(trace, 3, since=1)[-1] == "return 3.5"


def test_the_caption_fits_below_the_pictures() -> None:
    # As wide as maze3 makes it, at the default height.
    wide = FloorPlan(torch.ones(11, 13, dtype=torch.bool), cell_size=128.0)
    # 1,801 observations with 216 waypoints, 72 of them false.
    trace = EpisodeTrace(
        **{
            name: np.tile(values.T, 361)[..., :1801].T
            for name, values in vars(episodes.trace()).items()
        }
    )
    trace.is_new_waypoint[360:] = trace.spurious_waypoint[360:] = False
    views = np.zeros((2, 120, 160, 3), np.uint8)
    _, frame = explored_frames(trace, views, plan=wide, every=1800)
    assert frame.shape[0] == 326
    strip = frame[300:]
    assert (strip[:, -3:] == 255).all()
    # Five texts and the trail's colours, with more than a word space between them.
    is_blank = (strip == 255).all((0, 2))
    blank = "".join("_" if white else "x" for white in is_blank)
    assert len(re.findall(r"x_{9,}(?=x)", blank)) == 5


def test_as_many_views_as_frames() -> None:
    with pytest.raises(ValueError, match="argument 2 is longer"):
        frames(VIEWS[:2], 2)


def navigated(**arguments):
    view = np.full((120, 160, 3), 40, np.uint8)
    target = np.full((60, 80, 3), (200, 0, 0), np.uint8)
    given = {
        "positions": [[192.0, 448], [225, 448]],
        "headings": [0.0, 0.0],
        "views": [view, view],
        "targets": [target, None],
        "goal": np.full((60, 80, 3), (0, 0, 200), np.uint8),
        "plan": FloorPlan(MASK, cell_size=128.0),
        "captions": ["decision 0", "decision 1"],
        "height": 200,
    }
    return list(navigated_frames(**(given | arguments)))


def test_a_frame_has_view_target_goal_and_plan_side_by_side():
    first, second = navigated()
    # The view is 200 * 4 / 3 = 267 wide; then 8 white, and two pictures of 96 high and
    # 128 wide, one above the other; then 8 white and the plan.
    assert first.shape == second.shape
    assert first.shape[0] == 200 + 26
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
        navigated(**{name: few[name]})
