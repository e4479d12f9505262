"""The batched TorchRL environment: specs, keys, resets, arguments."""

import gc
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import SerialEnv, StepCounter, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.envs.layouts import GATE, HALL, LANE, RING, TRACK
from toponav import keys
from toponav.envs import MazeEnv, load_maze

Make = Callable[..., MazeEnv]
#: Everything that an environment can give.
FULL = {"depth": (12, 16), "velocity": True, "privileged": True}


@pytest.fixture
def make() -> Iterator[Make]:
    """Makes environments of the gate and closes them after the test."""
    made = []

    def make(layout=GATE, **options) -> MazeEnv:
        env = MazeEnv(layout, **options)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close(raise_if_closed=False)


def actions(env: MazeEnv, *values: int) -> TensorDictBase:
    shape = env.batch_size
    action = torch.tensor(values[0] if not shape else values).expand(shape)
    return TensorDict({"action": action}, batch_size=shape)


class TestSpecs:
    @pytest.mark.parametrize("batch_size", [None, 1, 3])
    @pytest.mark.parametrize("options", [{}, FULL], ids=["pixels", "all"])
    def test_hold_alone(self, make: Make, batch_size: int | None, options) -> None:
        env = make(batch_size=batch_size, episode_length=5, goal=True, **options)
        check_env_specs(env, break_when_any_done="both")

    def test_hold_inside_a_serial_and_a_transformed_env(self) -> None:
        def one() -> MazeEnv:
            return MazeEnv(GATE, episode_length=5, **FULL)

        def several() -> MazeEnv:
            return MazeEnv(GATE, batch_size=2, episode_length=5, **FULL)

        for env in (
            SerialEnv(2, one),
            SerialEnv(2, several),
            TransformedEnv(several(), StepCounter()),
            SerialEnv(2, lambda: TransformedEnv(one(), StepCounter())),
            TransformedEnv(SerialEnv(2, one), StepCounter()),
        ):
            try:
                check_env_specs(env, break_when_any_done="both")
            finally:
                env.close()

    def test_are_those_of_the_dictionary_of_keys(self, make: Make) -> None:
        env = make(RING, batch_size=2, **FULL)
        data = env.rand_step(env.reset())["next"]
        expected = {
            keys.PIXELS: (torch.uint8, (120, 160, 3)),
            keys.REWARD: (torch.float32, (1,)),
            keys.DONE: (torch.bool, (1,)),
            keys.TERMINATED: (torch.bool, (1,)),
            keys.TRUNCATED: (torch.bool, (1,)),
            keys.DEPTH: (torch.float32, (12, 16)),
            keys.VELOCITY: (torch.float32, (6,)),
            keys.POSITION: (torch.float32, (2,)),
            keys.HEADING: (torch.float32, (1,)),
            keys.CELL: (torch.int64, (2,)),
            keys.GOAL_CELL: (torch.int64, (2,)),
            keys.BLOCKED: (torch.bool, (2,)),
            keys.RESPAWNED: (torch.bool, (1,)),
        }
        found = {
            key: (data[key].dtype, tuple(data[key].shape[1:]))
            for key in data.keys(True, True)
        }
        assert found == expected
        assert env.action_spec.n == 6
        assert env.action_spec.dtype == torch.int64

    def test_nothing_privileged_is_given_unasked(self, make: Make) -> None:
        env = make(goal=True)
        names = {*env.reset().keys(True, True), *env.rollout(1).keys(True, True)}
        assert not any(keys.PRIVILEGED in name for name in names)
        assert not names & {keys.DEPTH, keys.VELOCITY}


class TestTruth:
    def test_cells_and_doors_are_those_of_the_layout(self, make: Make) -> None:
        env = make(RING, batch_size=3, blocked=("b",), goal=True, privileged=True)
        for data in (env.reset(), env.rollout(5)[:, -1]["next"]):
            for row in range(3):
                x, y = data[keys.POSITION][row].tolist()
                assert tuple(data[keys.CELL][row].tolist()) == RING.cell_of(
                    x, y, env.world.motion.cell_size
                )
                assert tuple(data[keys.GOAL_CELL][row].tolist()) in RING.cells
            assert data[keys.BLOCKED].tolist() == [[False, True]] * 3

    def test_without_a_goal_its_cell_is_minus_one(self, make: Make) -> None:
        env = make(batch_size=2, privileged=True)
        assert env.reset()[keys.GOAL_CELL].tolist() == [[-1, -1]] * 2

    def test_respawned_tells_of_the_goal_and_nothing_terminates(
        self, make: Make
    ) -> None:
        env = make(LANE, batch_size=4, goal=True, episode_length=300, seed=0, **FULL)
        torch.manual_seed(0)
        data = env.rollout(300, break_when_any_done=False)["next"]
        respawned = data[keys.RESPAWNED]
        # A random walk in three cells meets the goal often.
        assert respawned.sum() > 4
        torch.testing.assert_close(data["reward"], 10.0 * respawned.float())
        assert not data["terminated"].any()
        assert (data[keys.VELOCITY][respawned[..., 0]] == 0).all()
        # The goal stays where it is.
        assert (data[keys.GOAL_CELL] == data[keys.GOAL_CELL][:, :1]).all()

    def test_slots_close_for_the_asked_rows(self, make: Make) -> None:
        env = make(batch_size=3, privileged=True, seed=1)
        data = env.reset()
        env.set_slot("a", closed=True, rows=[0, 2])
        data = env.step(data.set("action", torch.full((3,), 2)))["next"]
        assert data[keys.BLOCKED].tolist() == [[True], [False], [True]]
        env.set_slot("a", closed=False)
        data = env.step(data.set("action", torch.full((3,), 2)))["next"]
        assert not data[keys.BLOCKED].any()
        assert not env.reset()[keys.BLOCKED].any()


class TestVelocity:
    def test_is_the_move_in_the_agents_frame(self, make: Make) -> None:
        env = make(TRACK, velocity=True, privileged=True, seed=3)
        before = env.reset()
        assert before[keys.VELOCITY].tolist() == [0.0] * 6
        for action, forward, yaw in ((2, 0.0, 20.0), (3, 0.0, -20.0), (0, 22.6, 0.0)):
            data = env.step(before.set("action", torch.tensor(action)))["next"]
            velocity = data[keys.VELOCITY]
            angle = torch.deg2rad(before[keys.HEADING])
            moved = data[keys.POSITION] - before[keys.POSITION]
            # The frame before the decision: forward is (cos, sin), left (-sin, cos).
            ahead = (moved * torch.cat([angle.cos(), angle.sin()])).sum()
            left = (moved * torch.cat([-angle.sin(), angle.cos()])).sum()
            expected = torch.stack([ahead, left, *torch.zeros(4)])
            expected[3] = yaw
            torch.testing.assert_close(velocity, expected, atol=0.03, rtol=0)
            assert velocity[0] == pytest.approx(forward, abs=0.1)
            before = data

    def test_a_turn_over_north_is_small(self, make: Make) -> None:
        env = make(velocity=True, seed=0)
        data = env.reset()
        for _ in range(20):  # more than a full turn
            data = env.step(data.set("action", torch.tensor(2)))["next"]
            assert data[keys.VELOCITY][3] == pytest.approx(20.0, abs=0.05)


class TestClock:
    def test_truncates_at_the_episodes_length_only(self, make: Make) -> None:
        env = make(batch_size=2, episode_length=7)
        data = env.rollout(100)
        assert data.shape == (2, 7)
        done = data["next", "done"].squeeze(-1)
        assert done.tolist() == [[False] * 6 + [True]] * 2
        assert (data["next", "truncated"] == data["next", "done"]).all()
        assert not data["next", "terminated"].any()

    def test_runs_for_each_row_alone(self, make: Make) -> None:
        env = make(batch_size=2, episode_length=4)
        data = env.rollout(2)[:, -1]["next"]
        mask = torch.tensor([[False], [True]])
        data = env.reset(data.set("_reset", mask))
        later = env.rollout(4, auto_reset=False, tensordict=data)
        # Row 0 has gone two decisions, row 1 none.
        assert later["next", "done"].squeeze(-1).tolist() == [
            [False, True],
            [False] * 2,
        ]


class TestPartialReset:
    def test_leaves_the_other_rows_untouched(self, make: Make) -> None:
        env = make(batch_size=3, episode_length=20, goal=True, seed=0, **FULL)
        other = make(batch_size=3, episode_length=20, goal=True, seed=0, **FULL)
        before, mirror = env.reset(), other.reset()
        for step in (0, 4, 2):
            before = env.step(before.update(actions(env, *[step] * 3)))["next"]
            mirror = other.step(mirror.update(actions(env, *[step] * 3)))["next"]
        mask = torch.tensor([[False], [True], [False]])
        after = env.reset(before.clone().set("_reset", mask))
        kept = before.select(*after.keys(True, True))
        for row in (0, 2):
            assert (after[row] == kept[row]).all()
        assert (after["pixels"][1] != before["pixels"][1]).any()
        # And they go on as if nothing had happened.
        same = actions(env, 0, 4, 5)
        after = env.step(after.update(same))["next"]
        mirror = other.step(mirror.update(same))["next"]
        assert (after[[0, 2]] == mirror[[0, 2]]).all()

    def test_does_not_change_what_was_handed_out(self, make: Make) -> None:
        env = make(batch_size=2)
        first = env.reset()
        copy = first.clone()
        second = env.step(first.update(actions(env, 2, 2)))["next"]
        env.reset(second.clone().set("_reset", torch.tensor([[True], [False]])))
        env.rollout(2)
        assert (first.select(*copy.keys(True, True)) == copy).all()


class TestArguments:
    @pytest.mark.parametrize(
        ("layout", "options", "message"),
        [
            (GATE, {"batch_size": 0}, "batch_size must be at least 1, got 0"),
            (GATE, {"episode_length": 0}, "episode_length must be at least 1, got 0"),
            (GATE, {"blocked": ("q",)}, r"slots of gate \(a\), got 'q'"),
            (RING, {"blocked": ("a", "b")}, "ring in one piece, got a, b together"),
            (GATE, {"depth": (0, 16)}, r"sides of at least 1, got \(0, 16\)"),
            (GATE, {"apples": 99}, "at most 8 in gate"),
            (GATE, {"paintings": 1.5}, r"paintings must lie in \[0, 1\], got 1.5"),
        ],
    )
    def test_out_of_range_are_refused(self, layout, options, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            MazeEnv(layout, **options)

    def test_an_unknown_action_is_refused(self, make: Make) -> None:
        env = make()
        data = env.reset()
        with pytest.raises(ValueError, match=r"action must be in \[0, 6\), got 6"):
            env.step(data.update(actions(env, 6)))

    def test_the_art_settings_change_the_view(self, make: Make) -> None:
        views = [
            make(HALL, **options).reset()["pixels"]
            for options in ({}, {"texture_seed": 1}, {"paintings": 0.0}, {"marks": 0.0})
        ]
        for one, other in ((0, 1), (0, 2), (0, 3), (1, 2)):
            assert (views[one] != views[other]).float().mean() > 0.1


class TestClosing:
    def test_twice_is_harmless(self, make: Make) -> None:
        env = make(batch_size=2)
        env.reset()
        env.close()
        env.close(raise_if_closed=False)

    def test_ends_the_engines(self, make: Make, alive: Callable) -> None:
        env = make(batch_size=2)
        pids = env.games.pids
        assert len(set(pids)) == 2
        assert all(alive(pid) for pid in pids)
        env.close()
        assert not any(alive(pid) for pid in pids)

    def test_a_dropped_environment_ends_its_engines(self, alive: Callable) -> None:
        env = MazeEnv(GATE, batch_size=2)
        pids = env.games.pids
        del env
        gc.collect()
        assert not any(alive(pid) for pid in pids)


def test_the_view_is_a_picture_of_the_maze(make: Make) -> None:
    env = make(load_maze("maze1"), batch_size=4, seed=0)
    pixels = env.reset()["pixels"].numpy()
    for view in pixels:
        # A view close before a bare wall has as few as five colours.
        assert len(np.unique(view.reshape(-1, 3), axis=0)) >= 5
        assert view.std() > 10
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 20
