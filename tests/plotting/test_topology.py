"""Maps drawn on a plan, small and large ones, and by their edges alone."""

import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.offsetbox import AnnotationBbox

from tests import episodes
from tests.graph.maze_map import CELL_SIZE, MazeMap, make_maze_map as make_again
from toponav.plotting import FloorPlan, draw_graph, draw_topological_map, save_figure

PLAN = FloorPlan(episodes.MASK, cell_size=128.0)
SIZES = (100, 1_000, 10_000)
#: Pixels an inch of ``topology.png``.
DPI = 110
#: One map of a size serves all tests.
make_maze_map = cache(make_again)


def test_a_map_shows_each_kind_of_edge() -> None:
    poses = torch.tensor([[64.0, 64, 0], [192, 64, 0], [448, 64, 0]])
    edges, cost = torch.tensor([[0, 1], [0, 2], [1, 2]]), torch.tensor([1.0, 3.0, 1.0])
    spurious = torch.tensor([False, False, True])
    figure = draw_topological_map(poses, edges, cost, spurious, plan=PLAN, title="map")
    (axes,) = figure.axes
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == [
        "1 edge only seen",
        "1 edge walked",
        "1 edge spurious",
        "3 waypoints with their headings",
    ]


@pytest.mark.parametrize("num_edges", [0, 2])
def test_a_map_without_places_is_laid_out_from_its_edges(num_edges: int) -> None:
    edges = torch.tensor([[0, 1], [1, 2]])[:num_edges]
    figure = draw_graph(4, edges, torch.tensor([1.0, 3.0])[:num_edges], title="map")
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    (dots,) = (one for one in axes.collections if isinstance(one, PathCollection))
    assert dots.get_offsets().shape == (4, 2)
    assert len(np.unique(dots.get_offsets(), axis=0)) == 4
    lines = [one for one in axes.collections if isinstance(one, LineCollection)]
    assert [len(one.get_segments()) for one in lines] == [1] * num_edges


def test_views_stand_beside_their_waypoints_where_there_is_room() -> None:
    # A closed path of 40 waypoints, and one that no edge joins.
    ring = torch.stack([torch.arange(40), (torch.arange(40) + 1) % 40], 1)
    asked: list[int] = []

    def find_views(numbers: list[int]) -> dict[int, np.ndarray]:
        asked.extend(numbers)
        return {one: np.full((6, 8, 3), one, np.uint8) for one in numbers}

    figure = draw_graph(41, ring, torch.ones(40), find_views=find_views)
    (axes,) = figure.axes
    boxes = [one for one in axes.artists if isinstance(one, AnnotationBbox)]
    assert 6 <= len(boxes) == len(set(asked)) <= 30
    assert 40 not in asked
    (dots,) = (one for one in axes.collections if isinstance(one, PathCollection))
    for number, box in zip(asked, boxes, strict=True):
        assert box.xy == pytest.approx(dots.get_offsets()[number])
        assert (np.asarray(box.offsetbox.get_data()) == number).all()


def draw(made: MazeMap) -> Figure:
    plan = FloorPlan(made.mask, cell_size=CELL_SIZE)
    given = made.poses, made.edges, made.cost, made.spurious
    figure = draw_topological_map(*given, plan=plan, title="a map")
    figure.set_dpi(DPI)
    return figure


def render(figure: Figure) -> np.ndarray:
    """Its pixels, float ``[H, W, 3]`` in [0, 1]."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3] / 255


def brightness(colour: np.ndarray) -> np.ndarray:
    """Relative luminance of sRGB, in [0, 1]; WCAG 2, "relative luminance"."""
    linear = np.where(
        colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4
    )
    return linear @ [0.2126, 0.7152, 0.0722]


def at(figure: Figure, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels of points ``[N, 2]`` in map units."""
    x, y = figure.axes[0].transData.transform(points).T
    height = figure.bbox.height
    return np.floor(height - y).astype(int), np.floor(x).astype(int)


def cell_brightness(figure: Figure, made: MazeMap) -> np.ndarray:
    """Mean brightness of each cell, ``[rows, cols]``."""
    shown, (rows, columns) = brightness(render(figure)), made.mask.shape
    inside = (np.arange(24) + 0.5) / 24
    x, y = np.arange(columns)[:, None] + inside, np.arange(rows)[:, None] + inside
    grid = np.stack(np.meshgrid(x.ravel(), y.ravel()), -1).reshape(-1, 2) * CELL_SIZE
    found = shown[at(figure, grid)].reshape(rows, 24, columns, 24).mean((1, 3))
    # The first row of a layout is at the top, where y is largest.
    return found[::-1]


@pytest.mark.parametrize("num", SIZES)
def test_the_maze_is_recognised_below_its_map(num: int) -> None:
    made = make_maze_map(num)
    found, floor = cell_brightness(draw(made), made), made.mask.numpy()
    darkest, brightest = found[floor].min(), found[~floor].max()
    # Every cell of the floor against every wall: the contrast that WCAG 2 asks of
    # graphics is 3 to 1.
    assert (darkest + 0.05) / (brightest + 0.05) > 3
    # Edges are seen, too: without them the floor is brighter. A hundred waypoints leave
    # some cells empty.
    none = {"edges": made.edges[:0], "cost": made.cost[:0]}
    bare = replace(made, **none, spurious=made.spurious[:0])
    without = cell_brightness(draw(bare), made)
    assert (found[floor] < 0.97 * without[floor]).mean() > 0.75


@pytest.mark.parametrize("num", SIZES)
def test_false_edges_are_seen_among_all_others(num: int) -> None:
    made = make_maze_map(num)
    figure = draw(made)
    shown, share = render(figure), np.linspace(0.1, 0.9, 81)[:, None]
    ends = made.poses[made.edges[made.spurious], :2].double().numpy()
    assert len(ends)
    for one, other in ends:
        row, column = at(figure, one + share * (other - one))
        # A line of one pixel may lie beside the pixel of its middle.
        near = [shown[row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
        red, green, blue = np.moveaxis(np.stack(near), -1, 0)
        assert (((red > green + 0.15) & (red > blue + 0.25)).any(0)).mean() > 0.8


@pytest.mark.parametrize("num", SIZES)
def test_marks_fit_on_the_floor_and_can_be_seen(num: int) -> None:
    figure = draw(make_maze_map(num))
    figure.canvas.draw()
    (dots,) = (
        one for one in figure.axes[0].collections if isinstance(one, PathCollection)
    )
    # A dot of size s is sqrt(s) points wide, and at least a pixel.
    width = float(dots.get_sizes()[0]) ** 0.5
    assert width * DPI / 72 > 1
    rim = float(dots.get_linewidths()[0])
    assert rim < width / 2
    # Of the plan's 13 cells across, 63 are floor.
    cell = figure.axes[0].get_window_extent().width * 72 / figure.dpi / 13
    assert num * np.pi / 4 * (width + rim) ** 2 < 0.25 * 63 * cell**2
    # Headings are drawn where there is room.
    texts = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert texts[-1].endswith("with their headings") == (num < 10_000)


def test_the_legend_of_a_large_map_can_be_read() -> None:
    (axes,) = draw(make_maze_map(10_000)).axes
    *lines, dot = axes.get_legend().legend_handles
    assert len(lines) == 3
    for line in lines:
        assert line.get_linewidth() > 1
        red, green, blue, alpha = to_rgba(line.get_color())
        shade = brightness(1 - alpha * (1 - np.array([red, green, blue])))
        assert 1.05 / (shade + 0.05) > 2
    # Points that it is wide.
    assert float(dot.get_sizes()[0]) ** 0.5 > 4


def test_a_large_map_is_drawn_in_seconds_and_its_vectors_are_few(
    tmp_path: Path,
) -> None:
    made = make_maze_map(10_000)
    start = time.process_time()
    figure = draw(made)
    save_figure(figure, tmp_path / "map.png", dpi=DPI)
    # 2 s on the slow core where this was written.
    assert time.process_time() - start < 15
    save_figure(figure, tmp_path / "map.svg")
    assert (tmp_path / "map.svg").stat().st_size < 4_000_000


@pytest.mark.parametrize("num", [1_000, 10_000])
def test_a_large_map_without_places_unfolds(num: int) -> None:
    made = make_maze_map(num)
    start = time.process_time()
    figure = draw_graph(num, made.edges, made.cost)
    assert time.process_time() - start < 15
    (dots,) = (
        one for one in figure.axes[0].collections if isinstance(one, PathCollection)
    )
    places = np.asarray(dots.get_offsets())
    assert np.isfinite(places).all()
    # Neighbours are close, and what is far on foot is not: the median over edges is a
    # small part of that over all pairs.
    one, other = made.edges[~made.spurious].T.numpy()
    edge = np.median(np.linalg.norm(places[one] - places[other], axis=1))
    shuffled = np.random.default_rng(0).permutation(places)
    assert edge < 0.15 * np.median(np.linalg.norm(places - shuffled, axis=1))


@pytest.mark.parametrize("num", [620, 1_100])
def test_many_parts_and_single_waypoints_have_places(num: int) -> None:
    # A path of 600, and 20 or 500 that no edge joins: more than springs can unfold.
    path = torch.stack([torch.arange(599), torch.arange(1, 600)], 1)
    figure = draw_graph(num, path, torch.ones(599))
    places = np.asarray(figure.axes[0].collections[-1].get_offsets())
    assert places.shape == (num, 2)
    assert np.isfinite(places).all()
    assert len(np.unique(places[600:], axis=0)) == num - 600
    # The path is unfolded: a step is short beside the whole of it.
    steps = np.linalg.norm(np.diff(places[:600], axis=0), axis=1)
    assert steps.max() < 0.1 * np.ptp(places[:600], axis=0).max()
