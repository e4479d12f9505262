"""Odd layouts, drawn cell by cell, on the real engine."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.envs.layouts import drawn_layouts
from toponav.envs import Layout, make_random_layout
from toponav.envs.engines.doom.game import MazeGame
from toponav.envs.engines.doom.spec import CELL_SIZE, PLAYER_RADIUS
from toponav.envs.scene import SceneRules, draw_scene


def check_walk(layout: Layout, seed: int) -> None:
    """A random walk never comes nearer to a wall than the agent's radius."""
    generator = np.random.default_rng(seed)
    blocked = tuple(layout.slots)[:1]
    room = layout.num_cells - len(layout.slots)
    rules = SceneRules(apples=min(2, room - 1), blocked=blocked)
    game = MazeGame(layout)
    try:
        game.reset(draw_scene(layout, rules, generator, cell_size=CELL_SIZE))
        for _ in range(150):
            game.step(int(generator.choice(6, p=[0.4, 0.1, 0.1, 0.1, 0.15, 0.15])))
            # The engine's fixed-point numbers let it in by less than a unit.
            reach = PLAYER_RADIUS - 0.5
            for dx in (-reach, reach):
                for dy in (-reach, reach):
                    cell = layout.cell_of(game.pose.x + dx, game.pose.y + dy, CELL_SIZE)
                    assert layout.open_mask[cell]
                    assert cell not in {layout.slots[letter] for letter in blocked}
    finally:
        game.close()


@pytest.mark.slow
@settings(
    max_examples=6,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
@given(layout=drawn_layouts(), seed=st.integers(0, 99))
def test_any_valid_layout_runs_and_its_walls_hold(layout: Layout, seed: int) -> None:
    check_walk(layout, seed)


def test_a_random_layout_runs_and_its_walls_hold() -> None:
    check_walk(make_random_layout(4, 5, seed=1, loops=0.3), 0)


@pytest.mark.slow
def test_the_largest_layout_runs() -> None:
    check_walk(make_random_layout(50, 50, seed=0), 0)


def test_a_room_of_one_cell_runs() -> None:
    check_walk(Layout("***\n* *\n***", name="room"), 0)
