"""One maze on one engine: movement, apples, goal, slots."""

import itertools
import json
import math
from collections.abc import Iterator

import numpy as np
import pytest

from tests.envs.layouts import GATE, HALL, TRACK
from tests.envs.test_engines import STAND_IN
from toponav.envs import EngineError, Layout
from toponav.envs.engines.dmlab.game import MazeGame
from toponav.envs.engines.dmlab.spec import ACTIONS, CELL_SIZE, WORLD
from toponav.envs.scene import Pose, Scene, SceneRules, draw_scene

FORWARD, BACKWARD, LEFT, RIGHT, FORWARD_LEFT, FORWARD_RIGHT = range(6)
#: What the real engine did, in map units and degrees a decision.
RECORDED = json.loads((STAND_IN / "recorded.json").read_text())


@pytest.fixture(scope="module")
def track(module: str) -> Iterator[MazeGame]:
    game = MazeGame(TRACK)
    yield game
    game.close()


@pytest.fixture(scope="module")
def gate(module: str) -> Iterator[MazeGame]:
    game = MazeGame(GATE)
    yield game
    game.close()


def scene_at(
    layout: Layout,
    pose: tuple[float, float, float],
    *,
    apples: tuple[tuple[float, float], ...] = (),
    goal: tuple[float, float] | None = None,
    blocked: tuple[str, ...] = (),
) -> Scene:
    cell = goal and layout.cell_of(*goal, CELL_SIZE)
    rules = SceneRules(
        goal=goal is not None, blocked=blocked, goal_cells=cell and (cell,)
    )
    scene = draw_scene(layout, rules, np.random.default_rng(0), cell_size=CELL_SIZE)
    scene.start, scene.apples, scene.goal = Pose(*pose), apples, goal
    return scene


def walk(game: MazeGame, *actions: int) -> list[Pose]:
    """The poses after each action, the first one included."""
    poses = [game.pose]
    for action in actions:
        game.step(action)
        poses.append(game.pose)
    return poses


def lengths(poses: list[Pose]) -> list[float]:
    return [math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(poses)]


class TestMovement:
    def test_actions_are_in_the_papers_order(self) -> None:
        assert list(WORLD.actions) == [
            *("forward", "backward", "left", "right"),
            *("forward+left", "forward+right"),
        ]

    @pytest.mark.parametrize(("action", "sign"), [(FORWARD, 1), (BACKWARD, -1)])
    def test_a_walk_is_as_recorded(
        self, track: MazeGame, action: int, sign: int
    ) -> None:
        track.reset(scene_at(TRACK, (600, 150, 0)))
        poses = walk(track, *[action] * 6, *[LEFT] * 5)
        found = lengths(poses)
        # A decision is longer or shorter by a unit than the one before, as the engine's
        # clock and its frames fall.
        np.testing.assert_allclose(found[:6], RECORDED["ahead"], atol=1.1)
        np.testing.assert_allclose(found[6:], RECORDED["gliding"], atol=1.4)
        assert (poses[-1].x - 600) * sign > 0
        assert poses[6].y == 150

    @pytest.mark.parametrize(("action", "sign"), [(LEFT, 1), (RIGHT, -1)])
    def test_a_turn_is_exact_and_on_the_spot(
        self, track: MazeGame, action: int, sign: int
    ) -> None:
        track.reset(scene_at(TRACK, (600, 150, 350)))
        poses = walk(track, *[action] * 6)
        expected = [(350 + sign * 8.448 * i) % 360 for i in range(7)]
        np.testing.assert_allclose(
            [pose.heading for pose in poses], expected, atol=0.01
        )
        assert max(lengths(poses)) == 0.0

    def test_an_arc_glides_away_from_its_turn(self, track: MazeGame) -> None:
        ahead, left, turn = RECORDED["arc"]
        effect = ACTIONS["forward+left"][1]
        np.testing.assert_allclose(effect, (ahead, left, turn), atol=0.4)
        track.reset(scene_at(TRACK, (500, 150, 0)))
        *_, before, after = walk(track, *[FORWARD_LEFT] * 4)
        dx, dy = after.x - before.x, after.y - before.y
        angle = math.radians(before.heading)
        found = (
            dx * math.cos(angle) + dy * math.sin(angle),
            dy * math.cos(angle) - dx * math.sin(angle),
            after.heading - before.heading,
        )
        np.testing.assert_allclose(found, (ahead, left, turn), atol=1.0)

    def test_walls_stop_the_agent_at_its_radius(self, track: MazeGame) -> None:
        for heading, end in ((90, (150, 183.87)), (270, (150, 116.13))):
            track.reset(scene_at(TRACK, (150, 150, heading)))
            poses = walk(track, *[FORWARD] * 8)
            # The stand-in stops a frame before it would enter the wall.
            np.testing.assert_allclose(poses[-1][:2], end, atol=5.2)
            assert abs(poses[-1].y - 150) < 34


class TestStart:
    def test_the_agent_stands_where_the_scene_says(self, gate: MazeGame) -> None:
        for seed in range(3):
            generator = np.random.default_rng(seed)
            rules = SceneRules(apples=3, goal=True)
            scene = draw_scene(GATE, rules, generator, cell_size=CELL_SIZE)
            gate.reset(scene)
            np.testing.assert_allclose(gate.pose, scene.start, atol=0.01)

    def test_the_first_episode_is_as_all_others(self, module: str) -> None:
        game, played = MazeGame(TRACK), []
        try:
            for _ in range(2):
                game.reset(scene_at(TRACK, (250, 150, 0), apples=((350, 150),)))
                played.append([*walk(game, FORWARD, FORWARD_LEFT, RIGHT, FORWARD)])
                played[-1].append(game.pixels.tobytes())
        finally:
            game.close()
        assert played[0] == played[1]


class TestThings:
    def test_a_touched_apple_pays_one_and_is_gone(self, track: MazeGame) -> None:
        apples = ((350.0, 150.0), (650.0, 140.0), (650.0, 160.0))
        track.reset(scene_at(TRACK, (150, 150, 0), apples=apples))
        rewards = []
        for _ in range(36):
            track.step(FORWARD)
            rewards.append(track.reward)
        paid = [(i, reward) for i, reward in enumerate(rewards, 1) if reward]
        assert [reward for _, reward in paid] in ([1, 2], [1, 1, 1])
        # Touched 44 before their middle: after 156 and after 456 units.
        assert paid[0][0] == pytest.approx(9, abs=1)
        assert paid[1][0] == pytest.approx(24, abs=1)
        for _ in range(20):
            track.step(BACKWARD)
            assert track.reward == 0.0
        assert not track.respawned

    def test_the_goal_pays_and_puts_the_agent_where_the_scene_says(
        self, track: MazeGame
    ) -> None:
        apples, goal = ((250.0, 150.0), (1050.0, 150.0)), (450.0, 150.0)
        scene = scene_at(TRACK, (150, 150, 0), apples=apples, goal=goal)
        twin = scene_at(TRACK, (150, 150, 0), apples=apples, goal=goal)
        track.reset(scene)
        rewards = []
        while not track.respawned:
            track.step(FORWARD)
            rewards.append(track.reward)
        assert [reward for reward in rewards if reward] == [1.0, 10.0]
        np.testing.assert_allclose(track.pose, twin.next_start(), atol=0.01)
        # It goes on from there: turned to the west it comes upon the goal again, and
        # the apple that was taken is not back.
        track.step(LEFT)
        assert not track.respawned
        assert track.reward == 0.0
        rewards = []
        while not track.respawned:
            turned = (track.pose.heading - (180.0 if track.pose.x > 450 else 0.0)) % 360
            ahead = min(turned, 360 - turned) < 5
            track.step(FORWARD if ahead else RIGHT if turned < 180 else LEFT)
            rewards.append(track.reward)
            assert len(rewards) < 120
        assert sum(rewards) in (10.0, 11.0)
        assert track.reward == 10.0

    def test_an_apple_where_the_goal_puts_the_agent_pays(self, track: MazeGame) -> None:
        goal = 450.0, 150.0
        twin = scene_at(TRACK, (150, 150, 0), goal=goal)
        x, y, _ = twin.next_start()
        assert x > 600  # beyond the goal: not on the way there
        track.reset(scene_at(TRACK, (150, 150, 0), apples=((x, y),), goal=goal))
        rewards = []
        while not track.respawned:
            track.step(FORWARD)
            rewards.append(track.reward)
        assert [reward for reward in rewards if reward] == [11.0]
        track.step(LEFT)
        assert track.reward == 0.0


class TestSlots:
    #: The gate's slot spans x = 200 to 300 of its southern corridor at y = 150.
    @pytest.mark.parametrize("blocked", [(), ("a",)])
    def test_a_closed_one_is_a_wall(
        self, gate: MazeGame, blocked: tuple[str, ...]
    ) -> None:
        gate.reset(scene_at(GATE, (150, 150, 0), blocked=blocked))
        assert gate.closed == set(blocked)
        end = walk(gate, *[FORWARD] * 16)[-1].x
        assert end < 184 if blocked else end > 300

    def test_it_stays_as_it_is_in_an_episode(self, gate: MazeGame) -> None:
        gate.reset(scene_at(GATE, (150, 150, 0), blocked=("a",)))
        gate.set_slot("a", closed=True)
        rule = "slots must stay as they are while an episode runs on engine=dmlab"
        with pytest.raises(EngineError, match=f"^{rule}.* got 'a'$"):
            gate.set_slot("a", closed=False)
        assert gate.closed == {"a"}
        with pytest.raises(ValueError, match="got 'q'"):
            gate.check_slot("q", closed=True)
        assert HALL.slots == {}
