"""One maze on one engine: movement, apples, goal."""

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pytest

from tests.envs.layouts import HALL, TRACK
from tests.envs.scenes import scene_at
from toponav.envs import EngineError, load_maze
from toponav.envs.engines.doom.game import MazeGame
from toponav.envs.engines.doom.spec import CELL_SIZE, STEP_LENGTH, WORLD
from toponav.envs.scene import Pose, SceneRules, draw_scene

FORWARD, BACKWARD, LEFT, RIGHT, FORWARD_LEFT, FORWARD_RIGHT = range(6)


@pytest.fixture(scope="module")
def track() -> Iterator[MazeGame]:
    game = MazeGame(TRACK, inspect=True)
    yield game
    game.close()


@pytest.fixture(scope="module")
def hall() -> Iterator[MazeGame]:
    game = MazeGame(HALL, inspect=True)
    yield game
    game.close()


def walk(game: MazeGame, *actions: int) -> list[Pose]:
    """The poses after each action, the first one included."""
    poses = [game.pose]
    for action in actions:
        game.step(action)
        poses.append(game.pose)
    return poses


def lengths(poses: list[Pose]) -> list[float]:
    return [math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(poses)]


def things(game: MazeGame, name: str) -> list[tuple[float, float]]:
    """Positions of the engine's things of a name."""
    return [
        (thing.position_x, thing.position_y)
        for thing in game.engine.game.get_state().objects
        if thing.name == name
    ]


class TestMovement:
    def test_actions_are_in_the_papers_order(self) -> None:
        assert list(WORLD.actions) == [
            *("forward", "backward", "left", "right"),
            *("forward+left", "forward+right"),
        ]

    @pytest.mark.parametrize("action", [FORWARD, BACKWARD])
    def test_a_walk_reaches_full_speed_in_three_decisions(
        self, track: MazeGame, action: int
    ) -> None:
        track.reset(scene_at(TRACK, (768, 192, 0)))
        poses = walk(track, *[action] * 6)
        expected = [22.6, 32.7, 33.1, 33.1, 33.1, 33.1]
        np.testing.assert_allclose(lengths(poses), expected, atol=0.06)
        assert (poses[-1].x > 768) == (action == FORWARD)
        assert poses[-1].y == 192
        assert lengths(poses)[-1] == pytest.approx(STEP_LENGTH, abs=0.06)

    def test_a_cell_is_nearly_four_decisions(self) -> None:
        # 128 / 33.1 = 3.87.
        assert WORLD.motion is not None
        assert WORLD.motion.decisions_per_cell == pytest.approx(3.9, abs=0.05)

    def test_a_walk_stops_within_one_decision(self, track: MazeGame) -> None:
        track.reset(scene_at(TRACK, (192, 192, 0)))
        poses = walk(track, *[FORWARD] * 5, LEFT, LEFT, LEFT)
        np.testing.assert_allclose(lengths(poses)[-3:], [6.6, 0.3, 0.0], atol=0.05)

    def test_no_speed_is_left_after_a_stop(self, track: MazeGame) -> None:
        track.reset(scene_at(TRACK, (192, 192, 0)))
        poses = walk(track, FORWARD, LEFT, RIGHT, LEFT, RIGHT, FORWARD, FORWARD)
        np.testing.assert_allclose(lengths(poses)[-2:], [22.6, 32.7], atol=0.06)

    @pytest.mark.parametrize(
        ("action", "degrees"),
        [(LEFT, 20.0), (RIGHT, -20.0), (FORWARD_LEFT, 20.0), (FORWARD_RIGHT, -20.0)],
    )
    def test_a_turn_is_twenty_degrees(
        self, hall: MazeGame, action: int, degrees: float
    ) -> None:
        hall.reset(scene_at(HALL, (320, 320, 350)))
        headings = [pose.heading for pose in walk(hall, *[action] * 5)]
        expected = [(350 + degrees * i) % 360 for i in range(6)]
        # The engine's own rounding is 0.02 degrees a decision.
        np.testing.assert_allclose(headings, expected, atol=0.12)

    def test_turning_alone_stays_on_the_spot(self, hall: MazeGame) -> None:
        hall.reset(scene_at(HALL, (320, 320, 0)))
        assert max(lengths(walk(hall, *[LEFT] * 18))) == 0.0

    def test_walls_stop_the_agent_at_its_radius(self, hall: MazeGame) -> None:
        # The hall spans 128 to 512 both ways; the agent is 16 from its centre.
        for heading, end in ((0, (496, 320)), (90, (320, 496)), (180, (144, 320))):
            hall.reset(scene_at(HALL, (320, 320, heading)))
            poses = walk(hall, *[FORWARD] * 10)
            np.testing.assert_allclose(poses[-1][:2], end, atol=0.5)

    def test_walls_are_slid_along(self, hall: MazeGame) -> None:
        # At 30 degrees to the northern wall: 95 % of cos(30) x 33.1 = 27.2.
        hall.reset(scene_at(HALL, (150, 490, 30)))
        length = lengths(walk(hall, *[FORWARD] * 6))[-1]
        assert length == pytest.approx(27.2, abs=1.0)


class TestStart:
    def test_the_agent_stands_where_the_scene_says(self) -> None:
        layout = load_maze("maze1")
        game = MazeGame(layout)
        try:
            for seed in range(30):
                generator = np.random.default_rng(seed)
                scene = draw_scene(
                    layout,
                    SceneRules(apples=3, goal=True),
                    generator,
                    cell_size=CELL_SIZE,
                )
                game.reset(scene)
                np.testing.assert_allclose(game.pose[:2], scene.start[:2], atol=0.01)
                turned = (game.pose.heading - scene.start.heading + 180) % 360 - 180
                assert abs(turned) < 0.01
        finally:
            game.close()

    def test_a_start_inside_a_wall_is_refused(self, hall: MazeGame) -> None:
        with pytest.raises(EngineError, match=r"agent must start at .* put it at"):
            hall.reset(scene_at(HALL, (130, 320, 0)))

    def test_the_first_decision_moves(self, hall: MazeGame) -> None:
        # The engine freezes the player for the first eight tics of a level.
        hall.reset(scene_at(HALL, (320, 320, 0)))
        assert lengths(walk(hall, FORWARD)) == [pytest.approx(22.6, abs=0.06)]


class TestApples:
    def test_all_apples_are_there(self, track: MazeGame) -> None:
        # They are asked for in one tic; the engine must not drop any.
        places = tuple((float(x), 192.0) for x in range(320, 1400, 36))
        track.reset(scene_at(TRACK, (192, 192, 180), apples=places))
        assert len(places) == 30
        found = sorted(things(track, "MazeApple"))
        np.testing.assert_allclose(found, places, atol=0.01)

    def test_a_touched_apple_pays_one_and_is_gone(self, track: MazeGame) -> None:
        track.reset(scene_at(TRACK, (192, 192, 0), apples=((320, 192), (576, 192))))
        rewards = []
        for _ in range(16):
            track.step(FORWARD)
            rewards.append(track.reward)
        # Boxes of 16 and 20 touch 36 before the centre, at x = 284 and 540: after 92
        # (22.6 + 32.7 + 33.1 = 88.4 in three decisions) and after 348 units (88.4 + 7 x
        # 33.1 = 320.5 in ten, 353.6 in eleven).
        assert [i for i, reward in enumerate(rewards, 1) if reward] == [4, 11]
        assert sum(rewards) == 2.0
        assert things(track, "MazeApple") == []
        for _ in range(10):
            track.step(BACKWARD)
            assert track.reward == 0.0

    def test_two_apples_in_one_decision_pay_two(self, track: MazeGame) -> None:
        track.reset(scene_at(TRACK, (192, 192, 0), apples=((240, 180), (240, 204))))
        track.step(FORWARD)
        assert track.reward == 2.0

    def test_apples_are_seen(self, track: MazeGame) -> None:
        track.reset(scene_at(TRACK, (192, 192, 0)))
        empty = track.pixels.copy()
        track.reset(scene_at(TRACK, (192, 192, 0), apples=((320, 192),)))
        changed = (track.pixels != empty).any(axis=-1)
        assert 50 < changed.sum() < 2000


class TestGoal:
    GOAL = (448.0, 192.0)

    def start(self, game: MazeGame, seed: int = 0) -> None:
        game.reset(scene_at(TRACK, (320, 192, 0), goal=self.GOAL, seed=seed))

    def test_the_goal_pays_ten_and_puts_the_agent_elsewhere(
        self, track: MazeGame
    ) -> None:
        self.start(track)
        before = track.pose
        while not track.respawned:
            before = track.pose
            track.step(FORWARD)
        # In the decision of the touch itself, which is 36 before the goal.
        assert track.reward == 10.0
        assert before.x < 448 - 36 < before.x + STEP_LENGTH
        cell = TRACK.cell_of(*track.pose[:2], CELL_SIZE)
        assert cell in TRACK.cells
        assert cell != TRACK.cell_of(*self.GOAL, CELL_SIZE)
        # And without speed: turning does not move it.
        track.step(LEFT)
        track.step(LEFT)
        place = track.pose[:2]
        track.step(LEFT)
        assert track.pose[:2] == place
        assert track.reward == 0.0
        assert not track.respawned

    def test_the_goal_stays_and_every_respawn_differs(self, track: MazeGame) -> None:
        self.start(track)
        starts = set()
        for _ in range(6):
            assert things(track, "MazeGoal") == [pytest.approx(self.GOAL)]
            track.place(Pose(400.0, 192.0, 0.0))
            track.step(FORWARD)
            assert track.respawned
            assert track.reward == 10.0
            starts.add(track.pose)
        assert len(starts) == 6

    def test_respawns_are_the_scenes_function(self, track: MazeGame) -> None:
        found = []
        for seed in (5, 5, 6):
            self.start(track, seed)
            while not track.respawned:
                track.step(FORWARD)
            found.append(track.pose)
        assert found[0] == found[1]
        assert found[0] != found[2]

    def test_apple_and_goal_add_up(self, track: MazeGame) -> None:
        apple = (412.0, 192.0)
        scene = scene_at(TRACK, (366, 192, 0), goal=self.GOAL, apples=(apple,))
        track.reset(scene)
        total = 0.0
        while not track.respawned:
            track.step(FORWARD)
            total += track.reward
        assert total == 11.0
