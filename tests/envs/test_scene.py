"""What an episode puts into a maze."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.envs.layouts import GATE, HALL, LANE, RING, drawn_layouts, random_layouts
from toponav.envs import Layout, load_maze
from toponav.envs.scene import Pose, Scene, SceneRules, draw_scene

#: Side of a cell; any number would do.
CELL_SIZE = 128
CELL_ROOM = Layout("***\n* *\n***", name="room")


def draw(layout: Layout, rules: SceneRules, seed: int) -> Scene:
    return draw_scene(layout, rules, np.random.default_rng(seed), cell_size=CELL_SIZE)


def places_of(scene: Scene) -> list[tuple[float, float]]:
    goal = [] if scene.goal is None else [scene.goal]
    return [scene.start[:2], *scene.apples, *goal]


def check_place(layout: Layout, place: tuple[float, float]) -> None:
    """A place is in an open cell that is no slot, at most 0.2 cells off its centre."""
    cell = layout.cell_of(*place, CELL_SIZE)
    assert cell in layout.cells
    assert cell not in layout.slots.values()
    centre = layout.centre(cell, CELL_SIZE)
    # 0.2 x 128 = 25.6 map units.
    assert max(abs(a - b) for a, b in zip(place, centre, strict=True)) <= 25.6


@settings(max_examples=150, deadline=None)
@given(
    layout=random_layouts() | drawn_layouts(),
    seed=st.integers(0, 2**32),
    data=st.data(),
)
def test_start_goal_and_apples_have_cells_of_their_own(
    layout: Layout, seed: int, data: st.DataObject
) -> None:
    free = layout.num_cells - len(layout.slots)
    goal = data.draw(st.booleans()) and free > 1
    apples = data.draw(st.integers(0, min(free - 1 - goal, 12)))
    blocked = tuple(data.draw(st.sampled_from(["", *layout.slots])))
    rules = SceneRules(apples=apples, goal=goal, blocked=blocked)
    rules.check(layout)
    scene = draw(layout, rules, seed)
    places = places_of(scene)
    assert len(places) == 1 + apples + goal
    for place in places:
        check_place(layout, place)
    assert len({layout.cell_of(*place, CELL_SIZE) for place in places}) == len(places)
    assert scene.blocked == blocked
    assert 0.0 <= scene.start.heading < 360.0
    assert (scene.goal is None) == (scene.goal_cell is None)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_respawns_avoid_goal_and_slots(seed: int) -> None:
    scene = draw(GATE, SceneRules(goal=True), seed)
    starts = [scene.next_start() for _ in range(30)]
    assert len(set(starts)) == 30
    for start in starts:
        check_place(GATE, start[:2])
        assert GATE.cell_of(*start[:2], CELL_SIZE) != scene.goal_cell


def test_goals_lie_in_the_given_cells_and_all_cells_change_no_draw() -> None:
    layout = load_maze("maze1")
    free = [cell for cell in layout.cells if cell not in layout.slots.values()]

    def draw_goal(seed: int, cells: list[tuple[int, int]] | None) -> Scene:
        allowed = None if cells is None else tuple(cells)
        rules = SceneRules(apples=3, goal=True, goal_cells=allowed)
        rules.check(layout)
        return draw(layout, rules, seed)

    few = [draw_goal(seed, free[:2]) for seed in range(300)]
    goals = [scene.goal_cell for scene in few]
    assert set(goals) == set(free[:2])
    assert 120 < goals.count(free[0]) < 180
    for scene in few:
        assert (
            len({layout.cell_of(*place, CELL_SIZE) for place in places_of(scene)}) == 5
        )
    for seed in range(20):
        same, every = draw_goal(seed, None), draw_goal(seed, free)
        assert (same.start, places_of(same)) == (every.start, places_of(every))
        assert same.next_start() == every.next_start()


@pytest.mark.parametrize("cells", [(), ((0, 0),), (*LANE.cells, (9, 9))])
def test_goal_cells_must_be_cells_of_the_maze(cells) -> None:
    with pytest.raises(ValueError, match="goal_cells must be open cells"):
        SceneRules(goal=True, goal_cells=cells).check(LANE)


def test_the_same_generator_draws_the_same_scene() -> None:
    layout, rules = load_maze("maze1"), SceneRules(apples=5, goal=True, blocked=("a",))
    first, second = (draw(layout, rules, 7) for _ in range(2))
    assert places_of(first) == places_of(second)
    assert first.start == second.start
    assert [first.next_start() for _ in range(3)] == [
        second.next_start() for _ in range(3)
    ]


def test_starts_are_spread_over_cells_and_headings() -> None:
    # 200 starts in nine cells and four quadrants: about 22 and 50 each.
    starts = [draw(HALL, SceneRules(), seed).start for seed in range(200)]
    cells = [HALL.cell_of(*start[:2], CELL_SIZE) for start in starts]
    quadrants = np.bincount([int(start.heading // 90) for start in starts])
    assert min(cells.count(cell) for cell in HALL.cells) >= 8
    assert quadrants.min() >= 30
    # 25.6 off in x and y: the farthest of 200 comes near, none is farther.
    offsets = [
        math.dist(start[:2], HALL.centre(cell, CELL_SIZE))
        for start, cell in zip(starts, cells, strict=True)
    ]
    assert 28.0 < max(offsets) < 25.6 * math.sqrt(2)


class TestRules:
    @pytest.mark.parametrize(
        ("layout", "rules", "message"),
        [
            (LANE, SceneRules(apples=-1), "apples must be at least 0 .*, got -1"),
            (LANE, SceneRules(apples=3), "at most 2 in lane .*, got 3"),
            (LANE, SceneRules(apples=2, goal=True), "at most 1 in lane .*, got 2"),
            (RING, SceneRules(apples=6), "at most 5 in ring .*, got 6"),
            (CELL_ROOM, SceneRules(goal=True), "goal must be false in room: .*one"),
            (CELL_ROOM, SceneRules(apples=1), "at most 0 in room"),
            (LANE, SceneRules(blocked=("a",)), r"slots of lane \(none\), got 'a'"),
            (RING, SceneRules(blocked=("a", "b")), "one piece, got a, b together"),
        ],
    )
    def test_that_do_not_fit_are_refused(
        self, layout: Layout, rules: SceneRules, message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            rules.check(layout)

    def test_that_just_fit_are_kept(self) -> None:
        rules = SceneRules(apples=1, goal=True)
        rules.check(LANE)
        scene = draw(LANE, rules, 0)
        assert {LANE.cell_of(*place, CELL_SIZE) for place in places_of(scene)} == set(
            LANE.cells
        )

    def test_a_room_of_one_cell_has_a_start(self) -> None:
        SceneRules().check(CELL_ROOM)
        scene = draw(CELL_ROOM, SceneRules(), 0)
        assert isinstance(scene.start, Pose)
        check_place(CELL_ROOM, scene.start[:2])
