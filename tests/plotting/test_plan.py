import numpy as np
import pytest
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from tests.fakes import MAZES, parse
from toponav.plotting import FloorPlan, draw_plan
from toponav.plotting.plan import (
    AGENT,
    CLOSED,
    FLOOR,
    VALUE_COLOURS,
    WALL,
    draw_agent,
    draw_trajectory,
)

MASK, SLOTS = parse(MAZES["maze1"])


def pixels_of(axes, points):
    """Return the colours drawn at ``points``, [K, 2] in map units."""
    canvas = FigureCanvasAgg(axes.figure)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[..., :3] / 255
    x, y = axes.transData.transform(np.asarray(points, float)).T
    return image[image.shape[0] - 1 - y.astype(int), x.astype(int)]


def centre(row, column):
    return (column + 0.5) * 128, (14 - row - 0.5) * 128


def new_axes():
    return Figure(figsize=(6, 6), dpi=100).subplots()


def test_every_cell_has_the_colour_of_wall_or_floor():
    axes = new_axes()
    FloorPlan(MASK, cell_size=128.0).draw(axes)
    cells = [(row, column) for row in range(14) for column in range(14)]
    drawn = pixels_of(axes, [centre(*cell) for cell in cells])
    expected = [to_rgb(FLOOR if MASK[cell] else WALL) for cell in cells]
    np.testing.assert_allclose(drawn, expected, atol=0.03)


def test_closed_slot_is_filled_and_open_slot_is_not():
    axes = new_axes()
    FloorPlan(MASK, cell_size=128.0, slots=SLOTS, closed="b").draw(axes)
    # Beside the letter, where a slot shows stripes of two colours or the floor.
    for letter, colours in (("a", {FLOOR}), ("b", {CLOSED, "#22252a"})):
        x, y = centre(*SLOTS[letter])
        points = [(x + 40 + dx, y + dy) for dx in range(16) for dy in range(-50, 50)]
        drawn = pixels_of(axes, points)
        for colour in colours:
            assert (np.abs(drawn - to_rgb(colour)).max(1) < 0.06).any(), (
                letter,
                colour,
            )
    assert [text.get_text() for text in axes.texts] == ["a", "b"]


def test_axes_are_labelled_in_cells():
    axes = new_axes()
    FloorPlan(MASK, cell_size=128.0).draw(axes)
    FigureCanvasAgg(axes.figure).draw()
    labels = [tick.get_text() for tick in axes.get_xticklabels()]
    shown = zip(axes.get_xticks() / 128, labels, strict=True)
    assert all(label == f"{cells:.0f}" for cells, label in shown)
    assert {"0", "2", "4"} < set(labels)
    assert axes.get_xlabel() == "x (cells)"


def test_marks_are_in_the_legend():
    axes = new_axes()
    FloorPlan(
        MASK,
        cell_size=128.0,
        start=(*centre(12, 4), 90),
        goal=(1, 4),
        apples=[(2, 7), (10, 3)],
    ).draw(axes)
    _, labels = axes.get_legend_handles_labels()
    assert labels == ["apple", "goal", "start"]
    apples, goal, start = axes.collections
    assert apples.get_offsets().tolist() == [list(centre(2, 7)), list(centre(10, 3))]
    assert goal.get_offsets().tolist() == [list(centre(1, 4))]
    assert start.get_offsets().tolist() == [list(centre(12, 4))]


@pytest.mark.parametrize("heading", [30, 90, 180, 270])
def test_arrow_head_is_turned_counter_clockwise(heading):
    def corners(degrees):
        axes = new_axes()
        draw_agent(axes, (0.0, 0.0), degrees, colour=AGENT, label="")
        vertices = axes.collections[0].get_paths()[0].vertices[:4]
        return vertices @ [1, 1j] / np.linalg.norm(vertices)  # as complex numbers

    assert corners(0)[0] == pytest.approx(abs(corners(0)[0]))  # the tip, eastwards
    turned = corners(0) * np.exp(1j * np.radians(heading))
    np.testing.assert_allclose(corners(heading), turned, atol=1e-9)


def test_trajectory_is_coloured_by_its_values():
    axes = new_axes()
    FloorPlan(MASK, cell_size=128.0).draw(axes)
    places = [centre(10, column) for column in (1, 4, 8, 12)]
    shares, look = [0.0, 0.5, 0.75, 1.0], {"label": "share", "limits": (0.0, 1.0)}
    draw_trajectory(axes, places, shares, jump=1e9, **look)
    middles = [centre(10, column) for column in (2.5, 6, 10)]
    expected = VALUE_COLOURS([0.5, 0.75, 1.0])[:, :3]
    np.testing.assert_allclose(pixels_of(axes, middles), expected, atol=0.03)
    assert axes.figure.axes[1].get_ylabel() == "share"


def test_new_start_within_the_episode_is_not_joined():
    axes = new_axes()
    places = [[0, 0], [30, 0], [900, 0], [930, 0]]
    draw_trajectory(axes, places, range(4), label="t", jump=256, limits=(0, 3))
    assert len(axes.collections[1].get_segments()) == 2


def test_tensors_are_drawn_like_arrays():
    # The second step is a jump, so that not all values are drawn.
    tensors = {
        "places": torch.tensor(
            [[0.0, 0.0], [30.0, 20.0], [900.0, 500.0], [930.0, 530.0]]
        ),
        "values": torch.tensor([0, 1, 3, 2]),
        "agent": torch.tensor([640.0, 320.0]),
    }

    def drawn(places, values, agent):
        axes = new_axes()
        axes.set(xlim=(-50, 1000), ylim=(-50, 600))
        draw_trajectory(axes, places, values, label="t", jump=256, limits=(0, 4))
        draw_agent(axes, agent, 10.0, colour=AGENT, label="agent")
        canvas = FigureCanvasAgg(axes.figure)
        canvas.draw()
        return axes, np.asarray(canvas.buffer_rgba())

    axes, image = drawn(**tensors)
    _, expected = drawn(**{name: values.numpy() for name, values in tensors.items()})
    np.testing.assert_array_equal(image, expected)
    _, line, head = axes.collections
    assert [part.tolist() for part in line.get_segments()] == [
        [[0, 0], [30, 20]],
        [[900, 500], [930, 530]],
    ]
    assert line.get_array().tolist() == [1, 2]
    assert head.get_offsets().tolist() == [[640, 320]]


def test_a_closed_slot_must_be_one():
    with pytest.raises(ValueError, match=r"closed must be .* got \['z'\]"):
        FloorPlan(MASK, cell_size=128.0, closed="z")


def test_a_plan_alone_names_its_marks():
    plan = FloorPlan(MASK, cell_size=10.0, goal=(1, 4), apples=[(2, 7)])
    (axes,) = draw_plan(plan, title="maze1").axes
    assert axes.get_title(loc="left") == "maze1"
    assert axes.get_xlim() == (0, 140)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "apple",
        "goal",
    ]
