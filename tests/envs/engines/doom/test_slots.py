"""Slots of a maze on the real engine: doors that close and open."""

from collections.abc import Iterator

import numpy as np
import pytest
import vizdoom

from tests.envs.layouts import GATE, RING
from tests.envs.scenes import scene_at
from toponav.envs.engines.doom.game import MazeGame
from toponav.envs.engines.doom.spec import CELL_SIZE

FORWARD, BACKWARD, LEFT = 0, 1, 2
# The gate's slot spans x = 256 to 384 of its southern corridor at y = 192.
WEST, EAST, CORRIDOR = 256.0, 384.0, 192.0


@pytest.fixture(scope="module")
def gate() -> Iterator[MazeGame]:
    game = MazeGame(GATE)
    yield game
    game.close()


def start(game: MazeGame, x: float, *, blocked: tuple[str, ...] = ()) -> None:
    game.reset(scene_at(GATE, (x, CORRIDOR, 0), blocked=blocked))


def go(game: MazeGame, action: int, decisions: int) -> None:
    for _ in range(decisions):
        game.step(action)


def height(game: MazeGame) -> float:
    """How high the agent stands; a rising floor would lift it."""
    z = vizdoom.GameVariable.POSITION_Z
    return float(game.engine.game.get_game_variable(z))


def test_a_closed_slot_stops_the_agent_at_its_edge(gate: MazeGame) -> None:
    start(gate, 192, blocked=("a",))
    assert gate.closed == {"a"}
    go(gate, FORWARD, 10)
    # The agent's radius is 16.
    assert gate.pose.x == pytest.approx(WEST - 16, abs=0.5)


def test_an_open_slot_lets_it_through(gate: MazeGame) -> None:
    start(gate, 192)
    go(gate, FORWARD, 14)
    assert gate.pose.x > EAST + 64


def test_a_new_episode_opens_all_slots(gate: MazeGame) -> None:
    start(gate, 192, blocked=("a",))
    start(gate, 192)
    assert gate.closed == set()
    go(gate, FORWARD, 14)
    assert gate.pose.x > EAST + 64


def test_a_waiting_closing_ends_with_its_episode(gate: MazeGame) -> None:
    start(gate, 320)
    gate.set_slot("a", closed=True)
    start(gate, 192)
    go(gate, FORWARD, 14)
    assert gate.closed == set()
    assert gate.pose.x > EAST + 64


def test_a_slot_closes_in_mid_episode(gate: MazeGame) -> None:
    start(gate, 192)
    gate.step(LEFT)
    view = gate.pixels.copy()
    gate.set_slot("a", closed=True)
    assert gate.closed == set()  # with the next decision
    gate.step(3)
    assert gate.closed == {"a"}
    gate.step(LEFT)
    assert (gate.pixels != view).any()
    go(gate, FORWARD, 10)
    assert gate.pose.x < WEST - 15.5


def test_a_slot_opens_in_mid_episode(gate: MazeGame) -> None:
    start(gate, 192, blocked=("a",))
    go(gate, FORWARD, 5)
    gate.set_slot("a", closed=False)
    assert gate.closed == set()
    go(gate, FORWARD, 10)
    assert gate.pose.x > EAST + 16


def test_opening_takes_a_waiting_closing_back(gate: MazeGame) -> None:
    start(gate, 320)
    gate.set_slot("a", closed=True)
    gate.set_slot("a", closed=False)
    go(gate, FORWARD, 6)
    assert gate.closed == set()


def test_one_that_opens_and_closes_between_two_decisions_is_closed(
    gate: MazeGame,
) -> None:
    start(gate, 192, blocked=("a",))
    for _ in range(2):
        gate.set_slot("a", closed=False)
        gate.set_slot("a", closed=True)
    go(gate, FORWARD, 10)
    assert gate.closed == {"a"}
    assert gate.pose.x == pytest.approx(WEST - 16, abs=0.5)
    gate.set_slot("a", closed=False)
    go(gate, FORWARD, 10)
    assert gate.pose.x > EAST + 16


def test_closing_twice_is_closing_once(gate: MazeGame) -> None:
    start(gate, 192, blocked=("a",))
    gate.set_slot("a", closed=True)
    gate.step(LEFT)
    gate.set_slot("a", closed=False)
    gate.step(3)
    go(gate, FORWARD, 14)
    assert gate.pose.x > EAST + 16


@pytest.mark.parametrize("x", [320.0, WEST, WEST - 15, EAST + 15])
def test_closing_waits_while_the_agent_touches_the_slot(
    gate: MazeGame, x: float
) -> None:
    start(gate, x)
    gate.set_slot("a", closed=True)
    go(gate, LEFT, 3)
    assert gate.closed == set()
    assert height(gate) == 0.0
    # Clear of it the door shuts, and nobody was lifted or stuck.
    gate.step(LEFT)
    start_x = gate.pose.x
    while gate.pose.heading > 5 and gate.pose.heading < 355:
        gate.step(LEFT)
    go(gate, FORWARD, 14)
    assert gate.closed == {"a"}
    assert height(gate) == 0.0
    assert gate.pose.x > max(start_x, EAST + 16)


@pytest.mark.parametrize("x", np.linspace(145, 178, 12))
@pytest.mark.parametrize("decisions", [1, 2, 3])
def test_closing_before_a_running_agent_never_catches_it(
    gate: MazeGame, x: float, decisions: int
) -> None:
    # At every distance from the edge and at full speed: it ends on one side.
    start(gate, x)
    go(gate, FORWARD, decisions)
    gate.set_slot("a", closed=True)
    go(gate, FORWARD, 18 - decisions)
    assert gate.closed == {"a"}
    assert height(gate) == 0.0
    west_end, east_end = WEST - 16, 640 - 16
    assert min(abs(gate.pose.x - west_end), abs(gate.pose.x - east_end)) < 0.5


class TestBadSlots:
    def test_an_unknown_slot_is_refused(self, gate: MazeGame) -> None:
        start(gate, 192)
        for closed in (True, False):
            with pytest.raises(ValueError, match=r"slots of gate \(a\), got 'x'"):
                gate.check_slot("x", closed=closed)

    def test_a_closing_that_cuts_is_refused(self) -> None:
        game = MazeGame(RING)
        try:
            game.reset(scene_at(RING, (320, 192, 0), blocked=("a",)))
            with pytest.raises(ValueError, match="ring in one piece, got a, b"):
                game.check_slot("b", closed=True)
            # Nor while the other closing still waits.
            game.reset(scene_at(RING, (*RING.centre((2, 1), CELL_SIZE), 0)))
            game.set_slot("a", closed=True)
            game.step(LEFT)
            with pytest.raises(ValueError, match="ring in one piece, got a, b"):
                game.check_slot("b", closed=True)
            game.set_slot("a", closed=False)
            game.check_slot("b", closed=True)
            game.set_slot("b", closed=True)
            game.step(LEFT)
            assert game.closed == {"b"}
        finally:
            game.close()
