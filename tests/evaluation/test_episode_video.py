import re
from functools import partial

import numpy as np
import pytest
import torch
from matplotlib.colors import to_rgb

from tests.evaluation import episodes
from toponav.evaluation import EpisodeTrace, draw_plan, explored_frames
from toponav.evaluation.episode_video import caption
from toponav.evaluation.exploration_map import FALSE_WAYPOINT

PLAN = partial(draw_plan, open_mask=episodes.MASK)
VIEWS = np.random.default_rng(0).integers(0, 256, (5, 60, 80, 3), np.uint8)


def frames(views: np.ndarray, every: int) -> list[np.ndarray]:
    shown = explored_frames(episodes.trace(), views, draw=PLAN, every=every, height=120)
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


def test_a_false_waypoint_appears_when_it_is_born_and_stays() -> None:
    # Born with the third observation; the red dot is under the arrow at first.
    red = [count_of(frame[:120, 168:], FALSE_WAYPOINT) for frame in frames(VIEWS, 1)]
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
        "waypoints 2 (1 false)",
    ]
    assert caption(episodes.trace(), 0, since=-1)[2:] == [
        "reward +0.00",
        "return 0.0",
        "waypoints 1 (0 false)",
    ]


def test_the_caption_fits_below_the_pictures() -> None:
    # As wide as maze3 makes it, at the default height.
    wide = partial(draw_plan, open_mask=torch.ones(11, 13, dtype=torch.bool))
    # 1,801 observations with 216 waypoints, 72 of them false.
    trace = EpisodeTrace(
        **{
            name: np.tile(values.T, 361)[..., :1801].T
            for name, values in vars(episodes.trace()).items()
        }
    )
    trace.born[360:] = trace.false_birth[360:] = False
    views = np.zeros((2, 120, 160, 3), np.uint8)
    _, frame = explored_frames(trace, views, draw=wide, every=1800)
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
