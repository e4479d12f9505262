from functools import partial

import imageio.v3 as iio
import numpy as np
import pytest
import torch
from matplotlib.colors import to_rgb

from tests.fakes import MAZES, parse
from toponav.plotting import FloorPlan, render_plan, side_by_side, write_video
from toponav.plotting.plan import AGENT, VALUE_COLOURS

MASK, _ = parse(MAZES["maze3"])
PLAN = FloorPlan(MASK, cell_size=128.0)
render = partial(render_plan, PLAN, height=240)


def centre_of(picture, colour, tolerance=40):
    """Return the mean x and y (from the top) of the pixels of a colour."""
    wanted = np.asarray(to_rgb(colour)) * 255
    hits = np.argwhere(np.abs(picture.astype(float) - wanted).max(-1) < tolerance)
    return hits.mean(0)[::-1]


def test_the_dot_moves_as_the_agent_does():
    # Maze3 is 13 x 11 cells; the agent walks 6 cells east, then 4 cells north.
    places = np.array([[192.0, 192.0], [960.0, 192.0], [960.0, 704.0]])
    pictures = list(render(places, [0.0, 0.0, 90.0]))
    dots = np.array([centre_of(picture, AGENT) for picture in pictures])
    unit = 240 * 0.96 / 11  # pixels of a cell, at most: the margin is 2 %
    moved = np.diff(dots, axis=0) / unit
    # The arrow head in the dot moves its centre of blue by a pixel or two.
    np.testing.assert_allclose(moved, [[6, 0], [0, -4]], atol=0.35)


def test_the_trail_stays_and_is_coloured_by_time():
    places = np.stack([np.linspace(192, 1472, 30), np.full(30, 704.0)], 1)
    *_, last = render(places, np.zeros(30))
    for share in (0.1, 0.5, 0.8):
        colour = VALUE_COLOURS(share)[:3]
        assert np.isfinite(centre_of(last, colour, tolerance=12)).all()


def test_the_trail_can_be_coloured_by_a_value():
    places = np.stack([np.linspace(192, 1472, 30), np.full(30, 704.0)], 1)
    *_, last = render(places, np.zeros(30), values=np.full(30, 0.5))
    assert np.isfinite(centre_of(last, VALUE_COLOURS(0.5)[:3], tolerance=12)).all()
    by_time = np.asarray(VALUE_COLOURS(0.1)[:3]) * 255
    assert not (np.abs(last - by_time) < 12).all(-1).any()


def test_skipped_pictures_change_nothing_in_the_others():
    places = np.stack([np.linspace(192, 1472, 7), np.full(7, 704.0)], 1)
    every = list(render(places, np.zeros(7)))
    third = list(render(places, np.zeros(7), every=3))
    assert len(third) == 3
    assert all((a == b).all() for a, b in zip(every[::3], third, strict=True))


def test_dots_appear_at_their_decision_and_stay():
    places = np.array([[192.0, 192.0], [960.0, 192.0], [960.0, 704.0]])
    pictures = list(render(places, np.zeros(3), dots={1: "#ff00ff"}))
    plain = list(render(places, np.zeros(3)))
    assert (pictures[0] == plain[0]).all()
    dot = centre_of(pictures[2], "#ff00ff", tolerance=60)
    arrow = centre_of(plain[1], AGENT)  # the agent stood there then
    np.testing.assert_allclose(dot, arrow, atol=2)


def test_a_new_start_within_the_episode_leaves_no_trail():
    def trail_length(step):
        start, end = [1472.0 - step, 704.0], [1472.0, 704.0]
        *_, walked = render([start, end], [0, 0])
        *_, standing = render([end, end], [0, 0])
        return int((walked != standing).any((0, 2)).sum())

    # A step of two cells is a trail, anything longer a new start.
    assert trail_length(256) > 30
    assert trail_length(257) < 5


def test_the_plan_itself_is_not_painted_on():
    places = np.array([[192.0, 192.0], [300.0, 192.0]])
    first = list(render(places, [0, 0]))
    again = list(render(places, [0, 0]))
    assert all((a == b).all() for a, b in zip(first, again, strict=True))


def test_view_is_enlarged_without_smoothing():
    view = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
    plan = np.zeros((240, 100, 3), np.uint8)
    (frame,) = side_by_side([torch.from_numpy(view)], [plan], gap=4)
    assert frame.shape == (240, 320 + 4 + 100, 3)
    assert (frame[::2, :320:2] == view).all()
    assert (frame[1::2, 1:320:2] == view).all()
    assert (frame[:, 320:324] == 255).all()


def test_as_many_views_as_plans():
    plan = np.zeros((24, 10, 3), np.uint8)
    with pytest.raises(ValueError, match="argument 2 is shorter"):
        list(side_by_side(np.zeros((2, 12, 16, 3), np.uint8), [plan]))


def frames_of(*levels, shape=(64, 96, 3)):
    return [np.full(shape, level, np.uint8) for level in levels]


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_video_holds_the_frames_in_order(tmp_path, suffix):
    path = tmp_path / "deep" / f"walk{suffix}"
    write_video(path, iter(frames_of(20, 120, 220)), fps=5)
    read = iio.imread(path, index=None if suffix == ".mp4" else ...)
    assert read.shape == (3, 64, 96, 3)
    np.testing.assert_allclose(read.mean((1, 2, 3)), [20, 120, 220], atol=6)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_mp4_is_h264_that_every_player_shows(tmp_path):
    path = tmp_path / "odd.mp4"
    write_video(path, frames_of(10, 20, shape=(65, 97, 3)), fps=10)
    meta = iio.immeta(path, plugin="pyav")
    assert meta["codec"] == "h264"
    assert meta["video_format"] == "yuv420p"
    assert meta["fps"] == pytest.approx(10)
    assert iio.imread(path).shape[1:] == (64, 96, 3)


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "walk.gif"
    write_video(path, frames_of(1, 2))
    old = path.read_bytes()

    def broken():
        yield from frames_of(3)
        raise RuntimeError("lost the engine")

    with pytest.raises(RuntimeError, match="lost the engine"):
        write_video(path, broken())
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "frames", "fps", "message"),
    [
        ("a.avi", frames_of(1), 5, "path must end in .mp4 or .gif, got 'a.avi'"),
        ("a.gif", frames_of(1), 0, "fps must be at least 1, got 0"),
        ("a.gif", [], 5, "frames must have at least one frame, got none"),
        ("a.mp4", [], 5, "frames must have at least one frame, got none"),
    ],
)
def test_wrong_arguments_are_refused(tmp_path, name, frames, fps, message):
    with pytest.raises(ValueError, match=message):
        write_video(tmp_path / name, frames, fps=fps)
    assert not list(tmp_path.iterdir())


def test_wrong_arguments_of_a_plan_are_refused():
    places, zeros = [[0, 0], [1, 1]], [0.0, 0.0]
    for headings, more, message in (
        (zeros, {"height": 10}, "height must be at least 64 .* got 10 and 1"),
        (zeros, {"every": 0}, "every at least 1, got 240 and 0"),
        ([0.0], {}, "must be as many, got 2, 1 and 2"),
        (zeros, {"values": [1.0]}, "must be as many, got 2, 2 and 1"),
    ):
        with pytest.raises(ValueError, match=message):
            list(render(places, headings, **more))
