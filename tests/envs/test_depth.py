"""Exact depth: by hand, and against the engine's own picture."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.envs.layouts import GATE, HALL, LANE, RING
from toponav.envs import Layout, load_maze
from toponav.envs.depth import DepthCaster
from toponav.envs.engines.doom.game import MazeGame
from toponav.envs.engines.doom.spec import CAMERA, CELL_SIZE
from toponav.envs.scene import Pose, Scene, SceneRules, draw_scene

# The engine's depth has 8 bits; one level is so many map units.
UNITS_PER_LEVEL = 7.43


def caster_of(layout: Layout, size: tuple[int, int]) -> DepthCaster:
    return DepthCaster(layout, size, camera=CAMERA, cell_size=CELL_SIZE)


def draw(layout: Layout, closed: str, generator: np.random.Generator) -> Scene:
    rules = SceneRules(blocked=tuple(closed))
    return draw_scene(layout, rules, generator, cell_size=CELL_SIZE)


def cast(
    layout: Layout,
    size: tuple[int, int],
    pose: tuple[float, float, float],
    closed: list[bool] | None = None,
) -> NDArray[np.float32]:
    x, y, heading = (np.array([value]) for value in pose)
    shut = None if closed is None else np.array([closed])
    return caster_of(layout, size).cast(x, y, heading, shut)[0]


class TestByHand:
    def test_ahead_is_the_end_of_the_corridor(self) -> None:
        # From the middle of the western cell, x = 192, to the wall at x = 512; west
        # to the wall at 128; north to the wall at y = 256.
        for heading, depth in ((0, 320.0), (180, 64.0), (90, 64.0), (270, 64.0)):
            assert cast(LANE, (1, 1), (192, 192, heading))[0, 0] == pytest.approx(depth)

    def test_depth_is_planar(self) -> None:
        # All of a wall that is faced squarely is 64 units away, not only its middle.
        row = cast(HALL, (1, 9), (320, 448, 90))[0]
        np.testing.assert_allclose(row, 64.0, rtol=1e-6)

    def test_columns_are_spread_over_ninety_degrees(self) -> None:
        # Four columns at tan = -0.75, -0.25, 0.25, 0.75 of a corridor of half width
        # 64 whose end is 320 away: 64 / 0.75 = 85.3, 64 / 0.25 = 256.
        row = cast(LANE, (1, 4), (192, 192, 0))[0]
        np.testing.assert_allclose(row, [85.333, 256, 256, 85.333], rtol=1e-4)

    def test_left_is_left(self) -> None:
        # Nearer to the northern wall (16 units) than to the southern one (112), and
        # the left column looks north: 16 / 0.5 = 32; 112 / 0.5 = 224.
        row = cast(LANE, (1, 2), (192, 240, 0))[0]
        np.testing.assert_allclose(row, [32.0, 224.0], rtol=1e-6)

    def test_rows_see_sky_wall_and_floor(self) -> None:
        # Tangents of five rows: -0.5, -0.25, 0, 0.25, 0.5. The wall ahead is 320
        # away: its top (80 above the eye) is passed at 320 x 0.5 = 160 > 80 and is
        # just met at 320 x 0.25 = 80; the floor is met at 48 / 0.25 = 192, / 0.5 = 96.
        column = cast(LANE, (5, 1), (192, 192, 0))[:, 0]
        far = math.hypot(3, 5) * 128
        np.testing.assert_allclose(column[[0, 2, 3, 4]], [far, 320, 192, 96], rtol=1e-6)

    def test_a_closed_slot_is_a_wall(self) -> None:
        # Along the gate's southern corridor, from x = 192: the slot begins at 256.
        assert cast(GATE, (1, 1), (192, 192, 0))[0, 0] == pytest.approx(448.0)
        assert cast(GATE, (1, 1), (192, 192, 0), [True])[0, 0] == pytest.approx(64.0)

    def test_each_row_of_a_batch_has_its_own_doors(self) -> None:
        place, heading = np.full(2, 192.0), np.zeros(2)
        caster = caster_of(GATE, (1, 1))
        both = caster.cast(place, place, heading, np.array([[True], [False]]))
        np.testing.assert_allclose(both[:, 0, 0], [64.0, 448.0])

    def test_a_diagonal_view_into_a_corner(self) -> None:
        # From the hall's middle to its north-east corner: 1.5 x 128 x sqrt(2).
        depth = cast(HALL, (1, 1), (320, 320, 45))[0, 0]
        assert depth == pytest.approx(192 * math.sqrt(2), rel=1e-6)

    def test_no_depth_is_farther_than_the_sky(self) -> None:
        layout = load_maze("maze3")
        caster = caster_of(layout, (24, 32))
        x, y = np.array([layout.centre(cell, CELL_SIZE) for cell in layout.cells]).T
        for heading in range(0, 360, 30):
            depth = caster.cast(x, y, np.full(len(x), float(heading)))
            assert depth.min() > 0
            assert depth.max() <= np.float32(caster.far)


@pytest.mark.parametrize("size", [(0, 4), (4, 0), (-1, -1)])
def test_a_picture_without_pixels_is_refused(size: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=r"sides of at least 1, got \("):
        caster_of(LANE, size)


@pytest.fixture(scope="module")
def maze1() -> Iterator[MazeGame]:
    game = MazeGame(load_maze("maze1"), inspect=True)
    yield game
    game.close()


@pytest.mark.parametrize("closed", ["", "ab"])
def test_the_engine_measures_the_same(maze1: MazeGame, closed: str) -> None:
    layout, generator = maze1.layout, np.random.default_rng(0)
    doors = [letter in closed for letter in layout.slots]
    errors = []
    for _ in range(25):
        scene = draw(layout, closed, generator)
        maze1.reset(scene)
        exact = cast(layout, (120, 160), maze1.pose, doors)
        # Farther away the engine's walls saturate, and its sky holds anything.
        near = exact < 440.0
        errors.append(np.abs(engine_depth(maze1)[near] - exact[near]))
    error = np.concatenate(errors)
    assert len(error) > 100_000
    # Within one level (7.4 units) on average, nearly always within two.
    assert error.mean() < UNITS_PER_LEVEL
    assert np.quantile(error, 0.95) < 2 * UNITS_PER_LEVEL


def test_the_engine_sees_through_an_open_door_only(maze1: MazeGame) -> None:
    # One cell south of slot a, facing it: its edge is 64 away.
    row, column = maze1.layout.slots["a"]
    pose = Pose(*maze1.layout.centre((row + 1, column), CELL_SIZE), 90.0)
    ahead = {}
    for closed in ("", "a"):
        maze1.reset(draw(maze1.layout, closed, np.random.default_rng(0)))
        maze1.place(pose)
        ahead[closed] = engine_depth(maze1)[60, 80]
        exact = cast(maze1.layout, (1, 1), pose, [closed == "a", False])[0, 0]
        assert min(exact, 440.0) - 8 < ahead[closed]
    assert ahead["a"] == pytest.approx(64, abs=8)


def engine_depth(game: MazeGame) -> NDArray[np.float64]:
    depth: NDArray[np.float64] = (
        game.engine.game.get_state().depth_buffer * UNITS_PER_LEVEL
    )
    return depth


def test_a_ring_has_no_view_through_its_middle() -> None:
    assert cast(RING, (1, 1), (320, 192, 90))[0, 0] == pytest.approx(64.0)
