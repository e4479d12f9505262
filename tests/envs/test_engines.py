"""What every engine must do; a new engine is one more name in `NAMES`.

An engine that its users install runs twice: against a stand-in for its Python module,
which was recorded from it, and itself where it is installed.
"""

import importlib.util
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import StepCounter, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.envs import fake_engine
from tests.envs.layouts import GATE, HALL, LANE, RING
from toponav import keys
from toponav.envs import ENGINES, EngineError, MazeEnv, MazeGymEnv, end_stray_engines
from toponav.envs.engines import load_engine

FULL = {"depth": (6, 8), "velocity": True, "privileged": True}
STAND_IN = Path(__file__).parent / "engines" / "dmlab" / "stand_in"
needs_dmlab = pytest.mark.skipif(
    importlib.util.find_spec("deepmind_lab") is None,
    reason="the engine is installed by its users",
)


def is_stand_in() -> bool:
    """Whether the module that Python finds is the stand-in."""
    found = importlib.util.find_spec("deepmind_lab")
    return found is not None and Path(str(found.origin)).parent == STAND_IN


NAMES = [
    *("fake", "dmlab", "vizdoom"),
    pytest.param("dmlab installed", marks=[needs_dmlab, pytest.mark.slow]),
]
#: Those whose maps are compiled: their slots stay as they are in an episode.
COMPILED = {"dmlab"}


@pytest.fixture(autouse=True)
def registered_fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """All that a new engine needs besides its room."""
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    yield
    fake_engine.GAMES.clear()


@pytest.fixture
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """An engine of `NAMES`, with the stand-in where that is wanted."""
    name, *installed = request.param.split()
    if name == "dmlab" and not installed:
        monkeypatch.syspath_prepend(str(STAND_IN))
    assert name != "dmlab" or is_stand_in() != bool(installed)
    return str(name)


@pytest.mark.parametrize("engine", NAMES, indirect=True)
class TestEveryEngine:
    def test_keeps_its_specs(self, engine: str) -> None:
        env = MazeEnv(GATE, engine=engine, batch_size=2, episode_length=5, **FULL)
        try:
            check_env_specs(env, break_when_any_done="both")
            world = load_engine(engine).world
            assert env.world == world
            assert TransformedEnv(env, StepCounter()).world == world
            assert env.reset()["pixels"].shape == (2, *world.view_size, 3)
            assert env.action_spec.n == world.num_actions
        finally:
            env.close()

    def test_starts_where_the_scene_says(self, engine: str) -> None:
        env = MazeEnv(
            GATE, engine=engine, batch_size=3, goal=True, privileged=True, seed=0
        )
        try:
            data = env.reset()
            starts = [scene.start for scene in env.games.scenes]
            places = torch.cat([data[keys.POSITION], data[keys.HEADING]], -1)
            torch.testing.assert_close(places, torch.tensor(starts), atol=0.02, rtol=0)
            goals = [scene.goal_cell for scene in env.games.scenes]
            assert data[keys.GOAL_CELL].tolist() == [list(cell) for cell in goals]
        finally:
            env.close()

    def test_plays_running_episodes_again(self, engine: str) -> None:
        options = {"engine": engine, "apples": 2, "goal": True, "privileged": True}
        whole, other = (
            MazeEnv(GATE, batch_size=3, episode_length=9, seed=seed, **options)
            for seed in (0, 1)
        )
        generator = torch.Generator().manual_seed(0)

        def play(env: MazeEnv, now: TensorDictBase, actions: Tensor) -> TensorDictBase:
            steps = []
            for action in actions:
                step, now = env.step_and_maybe_reset(now.set("action", action))
                steps.append(step["next"].clone())
            return torch.stack(steps)

        def draw(length: int) -> Tensor:
            return torch.randint(
                whole.world.num_actions, (length, 3), generator=generator
            )

        try:
            start = whole.reset()
            # The rows are in episodes of their own numbers, at decisions of their own.
            play(whole, start, draw(5))
            some = TensorDict({"_reset": torch.tensor([[True], [False], [False]])}, [3])
            play(whole, whole.reset(some), draw(7))
            other.reset()
            other.games.resume_episodes(whole.games.running_episodes())
            actions = draw(20)
            first, second = (
                play(env, start.clone(), actions) for env in (whole, other)
            )
            assert first["done"].sum() == 3 + 2 + 2
            for key in first.keys(True, True):
                assert torch.equal(first[key], second[key]), key
        finally:
            whole.close()
            other.close()

    def test_moves_as_its_world_says(self, engine: str) -> None:
        options = {"velocity": True, "privileged": True, "seed": 0}
        env = MazeEnv(HALL, engine=engine, batch_size=12, **options)
        motion = env.world.motion
        assert motion is not None
        try:
            data = env.reset()
            for number, effect in enumerate(motion.effects):
                action = torch.full((12,), number)
                data = env.step(data.set("action", action))["next"]
                expected = torch.full((12,), effect.turn)
                # Headings are sums of turns: 0.01 too many are 18 in an episode.
                torch.testing.assert_close(
                    data[keys.VELOCITY][:, 3], expected, atol=1e-3, rtol=0
                )
            # At full speed: from where nothing is met in five decisions, wherever the
            # agent looks.
            fastest = max(range(len(motion.effects)), key=motion.effects.__getitem__)
            data, ahead = env.reset(), torch.full((12,), fastest)
            for _ in range(5):
                data = env.step(data.set("action", ahead))["next"]
            place = data[keys.POSITION] / motion.cell_size
            is_free = ((place > 1.4) & (place < 3.6)).all(-1)
            assert is_free.any()
            speed = data[keys.VELOCITY][is_free, :2].norm(dim=-1)
            effect = motion.effects[fastest]
            full = torch.full_like(speed, math.hypot(effect.ahead, effect.left))
            torch.testing.assert_close(speed, full, rtol=0.03, atol=0)
        finally:
            env.close()

    def test_pays_the_goal_and_goes_on(self, engine: str) -> None:
        env = MazeEnv(
            LANE,
            engine=engine,
            batch_size=4,
            goal=True,
            episode_length=300,
            seed=0,
            **FULL,
        )
        torch.manual_seed(0)
        try:
            data = env.rollout(300, break_when_any_done=False)["next"]
        finally:
            env.close()
        respawned = data[keys.RESPAWNED]
        assert respawned.sum() > 2
        reward = env.world.goal_reward * respawned.float()
        torch.testing.assert_close(data["reward"], reward)
        assert (data[keys.VELOCITY][respawned[..., 0]] == 0).all()
        assert not data["terminated"].any()
        assert data["truncated"][:, -1].all()

    def test_closes_slots_or_says_why_not(self, engine: str) -> None:
        env = MazeEnv(GATE, engine=engine, batch_size=2, privileged=True, seed=1)
        action = torch.full((2,), env.world.num_actions - 1)
        try:
            data = env.reset()
            if engine in COMPILED:
                with pytest.raises(EngineError, match=r"slots must stay .* got 'a'"):
                    env.set_slot("a", closed=True, rows=[1])
            else:
                env.set_slot("a", closed=True, rows=[1])
            data = env.step(data.set("action", action))["next"]
            expected = [[False], [engine not in COMPILED]]
            assert data[keys.BLOCKED].tolist() == expected
            with pytest.raises(ValueError, match=r"slots of gate \(a\), got 'q'"):
                env.set_slot("q", closed=True)
        finally:
            env.close()

    def test_begins_with_closed_slots(self, engine: str) -> None:
        options = {"engine": engine, "privileged": True, "seed": 0}
        env = MazeEnv(GATE, batch_size=2, blocked=("a",), **options)
        try:
            data = env.rollout(30)["next"]
            assert data[keys.BLOCKED].all()
            slot = torch.tensor(GATE.slots["a"])
            assert not (data[keys.CELL] == slot).all(-1).any()
        finally:
            env.close()

    def test_plays_the_same_episodes_for_the_same_seed(self, engine: str) -> None:
        env = MazeEnv(
            GATE, engine=engine, batch_size=2, apples=3, goal=True, privileged=True
        )
        actions = np.random.default_rng(0).integers(env.world.num_actions, size=(8, 2))
        rollouts = []
        try:
            for _ in range(2):
                env.set_seed(5)
                data = env.reset()
                views = [data]
                for action in actions:
                    data = env.step(data.set("action", torch.tensor(action)))["next"]
                    views.append(data.select("pixels", keys.POSITION))
                rollouts.append(torch.stack([view["pixels"] for view in views]))
        finally:
            env.close()
        assert (rollouts[0] == rollouts[1]).all()

    @pytest.mark.parametrize("action", [-1, 99])
    def test_refuses_an_unknown_action(self, engine: str, action: int) -> None:
        env = MazeEnv(LANE, engine=engine)
        try:
            data = env.reset().set("action", torch.tensor(action))
            count = env.world.num_actions
            with pytest.raises(ValueError, match=rf"in \[0, {count}\), got {action}"):
                env.step(data)
        finally:
            env.close()


def test_a_lost_engine_is_replaced_at_the_next_reset() -> None:
    env = MazeEnv(LANE, engine="fake", batch_size=2)
    data = env.reset()
    fake_engine.GAMES[0].is_dead = True
    with pytest.warns(RuntimeWarning, match="maze . of the batch lost its engine"):
        data = env.step(env.rand_action(data))["next"]
    assert data["truncated"].sum() == 1
    data = env.reset(data.set("_reset", data["done"]))
    assert not env.step(env.rand_action(data))["next", "truncated"].any()
    env.close()
    assert all(game.is_ended for game in fake_engine.GAMES)


def test_a_lost_engine_does_not_report_its_last_goal_again() -> None:
    env = MazeEnv(LANE, engine="fake", goal=True, privileged=True)
    data = env.reset()
    (game,) = fake_engine.GAMES
    game.respawned, game.is_dead = True, True  # as after a decision onto the goal
    with pytest.warns(RuntimeWarning, match="maze 0 of the batch lost its engine"):
        data = env.step(env.rand_action(data))["next"]
    env.close()
    assert data["truncated"].all()
    assert not data[keys.RESPAWNED].any()


@pytest.mark.timeout(60)
def test_closed_mazes_refuse_to_play() -> None:
    env = MazeEnv(LANE, engine="fake", batch_size=2)
    action = env.rand_action(env.reset())
    episodes = env.games.running_episodes()
    env.close()
    gym_env = MazeGymEnv(LANE, engine="fake")
    gym_env.reset(seed=0)
    gym_env.close()
    plays = [
        *(env.reset, lambda: env.rollout(2), lambda: env.step(action)),
        lambda: env.games.resume_episodes(episodes),
        *(gym_env.reset, lambda: gym_env.step(np.int64(0))),
    ]
    for play in plays:
        with pytest.raises(EngineError, match="must be open, and they were closed"):
            play()


@pytest.mark.parametrize("engine", ["fake", "vizdoom"], indirect=True)
def test_a_slot_moves_in_all_rows_or_in_none(engine: str) -> None:
    env = MazeEnv(RING, engine=engine, batch_size=2, privileged=True, seed=0)
    turn = torch.full((2,), 2)
    try:
        data = env.reset()
        env.set_slot("a", closed=True, rows=[1])
        with pytest.raises(ValueError, match="ring in one piece, got a, b together"):
            env.set_slot("b", closed=True)
        data = env.step(data.set("action", turn))["next"]
        assert data[keys.BLOCKED].tolist() == [[False, False], [True, False]]
        with pytest.raises(ValueError, match="ring in one piece, got a, b together"):
            env.set_slot("b", closed=True)
        env.set_slot("a", closed=False)
        env.set_slot("b", closed=True)
        data = env.step(data.set("action", turn))["next"]
        assert data[keys.BLOCKED].tolist() == [[False, True]] * 2
        env.reset()  # opens all
        env.set_slot("a", closed=True)
    finally:
        env.close()


def test_a_gymnasium_maze_runs_on_any_engine() -> None:
    env = MazeGymEnv("maze1", engine="fake")
    view, _ = env.reset(seed=0)
    assert view.shape == (24, 36, 3)
    assert env.action_space.n == 3
    env.close()


def test_an_unknown_engine_is_refused_with_the_nearest() -> None:
    message = (
        r"engine must be one of dmlab, fake, vizdoom, got 'VizDoom' .*mean 'vizdoom'"
    )
    for make in (MazeEnv, MazeGymEnv):
        with pytest.raises(ValueError, match=message):
            make(LANE, engine="VizDoom")


def test_an_engine_that_is_not_installed_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    engine = fake_engine.GameEngine(
        world=fake_engine.WORLD, camera=fake_engine.CAMERA, start=fake_engine.missing
    )
    monkeypatch.setattr(fake_engine, "ENGINE", engine)
    with pytest.raises(EngineError, match="must be installed, and it is not: buy one"):
        MazeEnv(LANE, engine="fake")


def test_stray_engines_are_counted_over_all_engines(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = end_stray_engines()
    engine = fake_engine.GameEngine(
        world=fake_engine.WORLD,
        camera=fake_engine.CAMERA,
        start=fake_engine.start,
        end_strays=lambda: 2,
    )
    monkeypatch.setattr(fake_engine, "ENGINE", engine)
    assert (before, end_stray_engines()) == (0, 2)
